"""What a finished run's milling programs make of its lens: in numbers, and in pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from magiclens.artifacts import FloatArray, Scene, Solid
from magiclens.errors import InputError
from magiclens.images.score import score
from magiclens.milling.machining import (
    Machined,
    faults,
    find_programs,
    polished,
    ridge_width_mm,
    simulate,
)
from magiclens.reopen import Reopened, reopen

FOLDER = "machined"


def machined(folder: str | Path) -> str:
    """Run the milling programs of a run folder without a machine; a summary as text.

    Writes ``machined/<view>.png``, what each view's eye sees through the lens as cut, and ``<view>-polished.png``, the
    same after its ridges are polished away. Raises InputError if there is no program or it is not understood.
    """
    lens = reopen(folder)
    paths = find_programs(lens.folder)
    if not paths:
        wish = "there is no milling program; run its spec with --set 'pipeline.exporters=[{type: gcode}]'"
        raise InputError(wish, str(lens.folder))
    made = simulate(paths, lens.solid)
    width = ridge_width_mm(made.programs) / 2
    solids = {"designed": lens.solid, "as cut": made.solid, "polished": polished(made.solid, width)}
    return "\n".join([*_numbers(paths, made), "", *_pictures(lens, solids)])


def _numbers(paths: Sequence[Path], made: Machined) -> list[str]:
    """How well the programs fit, and what is wrong with them."""
    fit, moves = made.fit, [program.moves for program in made.programs]
    minutes = sum(each.minutes() for each in moves)
    length = sum(each.length_mm() for each in moves)
    said = f"stated: at most {fit.stated_mm * 1000:.2f} um"
    wrong = [f"{path.name}: {text}" for path, p in zip(paths, made.programs, strict=True) for text in faults(p)]
    return [
        f"programs    {', '.join(path.name for path in paths)}",
        f"cutting     {length / 1000:.1f} m, about {minutes // 60:.0f} h {minutes % 60:.0f} min",
        f"gouge       {fit.gouge_mm * 1000:.2f} um",
        f"stock left  {fit.left_mm * 1000:.2f} um where the cutter reaches ({said})",
        f"unreached   {fit.unreached_share:.2%} of the surface, by up to {fit.unreached_mm * 1000:.1f} um",
        f"faults      {'; '.join(wrong) or 'none; no rapid move below the top of the plate'}",
    ]


def _pictures(lens: Reopened, solids: dict[str, Solid]) -> list[str]:
    """Trace every solid in every view, write what the made ones show, and compare with the targets."""
    from magiclens.images.files import write_png

    scene = lens.plan.on_medium(lens.printed_scene)
    seen = {name: _seen(scene, solid) for name, solid in solids.items()}
    (lens.folder / FOLDER).mkdir(exist_ok=True)
    lines = [f"{'psnr_db':16}" + "".join(f"{name:>12}" for name in solids)]
    for k, view in enumerate(scene.views):
        write_png(lens.folder / FOLDER / f"{view.name}.png", seen["as cut"][k])
        write_png(lens.folder / FOLDER / f"{view.name}-polished.png", seen["polished"][k])
        scores = [score(pictures[k], view.target).psnr_db for pictures in seen.values()]
        lines.append(f"{view.name:16}" + "".join(f"{value:12.2f}" for value in scores))
    return [*lines, "", f"{lens.folder / FOLDER}: {', '.join(f'{v.name}[-polished].png' for v in scene.views)}"]


def _seen(scene: Scene, solid: Solid) -> list[FloatArray]:
    from magiclens.rendering.tracer import Tracer

    return Tracer().render(scene, solid)
