"""What a finished run's milling programs make of its lens: in numbers, and in pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from magiclens.contract.errors import InputError
from magiclens.images.score import score
from magiclens.running.open_run import OpenRun, open_run
from magiclens.simulation.machining import Machined, faults, find_programs, seen_as_machined, simulate

FOLDER = "machined"


@dataclass(frozen=True)
class Outcome:
    """How the programs fit, in micrometres, and how well the lens as cut shows its targets.

    unreached: share of the surface that no cutter reaches, and by how much. psnr_db: by view, then by state.
    """

    folder: str
    programs: tuple[str, ...]
    minutes: float
    length_mm: float
    gouge_um: float
    left_um: float
    stated_um: float
    unreached_share: float
    unreached_um: float
    faults: tuple[str, ...]
    psnr_db: Mapping[str, Mapping[str, float]]


def machined(folder: str | Path) -> Outcome:
    """Run the milling programs of a run folder without a machine.

    Writes ``machined/<view>.png``, what each view's eye sees through the lens as cut, and ``<view>-polished.png``, the
    same after its ridges are polished away. Raises InputError if there is no program or it is not understood.
    """
    lens = open_run(folder)
    paths = find_programs(lens.folder)
    if not paths:
        wish = "there is no milling program; run its spec with --set 'pipeline.exporters=[{type: gcode}]'"
        raise InputError(wish, str(lens.folder))
    made = simulate(paths, lens.solid)
    fit, moves = made.fit, [program.moves for program in made.programs]
    wrong = [f"{path.name}: {text}" for path, p in zip(paths, made.programs, strict=True) for text in faults(p)]
    return Outcome(
        str(lens.folder),
        tuple(path.name for path in paths),
        float(sum(each.minutes() for each in moves)),
        float(sum(each.length_mm() for each in moves)),
        float(fit.gouge_mm * 1000),
        float(fit.left_mm * 1000),
        float(fit.stated_mm * 1000),
        float(fit.unreached_share),
        float(fit.unreached_mm * 1000),
        tuple(wrong),
        _pictures(lens, made),
    )


def as_text(found: Outcome) -> str:
    """A summary for a terminal."""
    said = f"stated: at most {found.stated_um:.2f} um"
    states = list(next(iter(found.psnr_db.values())))
    scores = [f"{view:16}" + "".join(f"{x:12.2f}" for x in found.psnr_db[view].values()) for view in found.psnr_db]
    lines = [
        f"programs    {', '.join(found.programs)}",
        f"cutting     {found.length_mm / 1000:.1f} m, about {found.minutes // 60:.0f} h {found.minutes % 60:.0f} min",
        f"gouge       {found.gouge_um:.2f} um",
        f"stock left  {found.left_um:.2f} um where the cutter reaches ({said})",
        f"unreached   {found.unreached_share:.2%} of the surface, by up to {found.unreached_um:.1f} um",
        f"faults      {'; '.join(found.faults) or 'none; no rapid move below the top of the plate'}",
        "",
        f"{'psnr_db':16}" + "".join(f"{state:>12}" for state in states),
        *scores,
        "",
        f"{Path(found.folder, FOLDER)}: {', '.join(f'{view}[-polished].png' for view in found.psnr_db)}",
    ]
    return "\n".join(lines)


def _pictures(lens: OpenRun, made: Machined) -> dict[str, dict[str, float]]:
    """Trace the lens as designed, as cut and polished in every view, write what it shows, compare with the targets."""
    from magiclens.images.files import write_png
    from magiclens.rendering.tracer import Tracer

    scene = lens.plan.on_medium(lens.printed_scene)
    cut, polished = seen_as_machined(scene, lens.solid, made.programs)
    seen = {"designed": Tracer().render(scene, lens.solid), "as cut": cut, "polished": polished}
    (lens.folder / FOLDER).mkdir(exist_ok=True)
    for k, view in enumerate(scene.views):
        write_png(lens.folder / FOLDER / f"{view.name}.png", seen["as cut"][k])
        write_png(lens.folder / FOLDER / f"{view.name}-polished.png", seen["polished"][k])
    return {
        view.name: {name: score(pictures[k], view.target).psnr_db for name, pictures in seen.items()}
        for k, view in enumerate(scene.views)
    }
