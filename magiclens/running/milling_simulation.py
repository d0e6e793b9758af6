"""Runs the milling programs of a finished run without a machine: how they fit its lens, and what it shows then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from magiclens.contract.errors import InputError
from magiclens.milling.exporter import MillingExporter
from magiclens.milling.program import MillingProgram
from magiclens.plan.blame import blaming
from magiclens.plan.compile import Plan
from magiclens.plan.registry import Registry
from magiclens.running.manifest import refresh_manifest
from magiclens.running.open_run import OpenRun, open_run
from magiclens.running.replacing import atomic_folder

MACHINED = "machined"
"""The folder of a run with the pictures of the machined lens."""


@dataclass(frozen=True)
class MillingReport:
    """How the programs fit, in micrometres, and how well the lens as cut shows its targets.

    Attributes:
        folder: The run folder.
        programs: Names of the programs' files.
        minutes: Time that all of them take.
        length_mm: Way of the cutter at feed speed, in all of them.
        gouge_um: See ``SurfaceFit``, as the next four.
        left_um: Stock left where the cutter reaches.
        stated_um: The most stock that the programs say they leave there.
        unreached_share: Share of the surface that the cutter does not reach.
        unreached_um: The most stock that is left there.
        faults: What would break cutters, in words.
        psnr_db: By view, then by state: designed, as cut, polished.
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

    def as_text(self) -> str:
        """A summary for a terminal."""
        states = list(next(iter(self.psnr_db.values())))
        scores = [f"{view:16}" + "".join(f"{x:12.2f}" for x in found.values()) for view, found in self.psnr_db.items()]
        pictures = ", ".join(f"{view}[-polished].png" for view in self.psnr_db)
        lines = [
            f"programs    {', '.join(self.programs)}",
            f"cutting     {self.length_mm / 1000:.1f} m, about {self.minutes // 60:.0f} h {self.minutes % 60:.0f} min",
            f"gouge       {self.gouge_um:.2f} um",
            f"stock left  {self.left_um:.2f} um where the cutter reaches (stated: at most {self.stated_um:.2f} um)",
            f"unreached   {self.unreached_share:.2%} of the surface, by up to {self.unreached_um:.1f} um",
            f"faults      {'; '.join(self.faults) or 'none; no rapid move below the top of the plate'}",
            "",
            f"{'psnr_db':16}" + "".join(f"{state:>12}" for state in states),
            *scores,
            "",
            f"{Path(self.folder, MACHINED)}: {pictures}",
        ]
        return "\n".join(lines)


def simulate_milling(folder: str | Path, registry: Registry | None = None) -> MillingReport:
    """Run the milling programs of a run folder without a machine.

    The programs are those of the first exporter of the run's plan that is a ``MillingExporter`` and has written some.
    Writes ``machined/<view>.png``, what each view's eye sees through the lens as cut, and ``<view>-polished.png``, the
    same after its ridges are polished away, and lists them in the manifest.

    Args:
        folder: of the run.
        registry: of the plugins; those that are installed if left out.

    Raises:
        InputError: there is no program, or a program is not understood.
        StageError: the exporter failed.
    """
    from magiclens.simulation.machining import faults, run_programs

    lens = open_run(folder, registry)
    programs = read_programs(lens.plan, lens.folder)
    fit = run_programs(list(programs.values()), lens.solid).fit
    moves = [program.moves for program in programs.values()]
    psnr_db = _write_pictures(lens, list(programs.values()))
    refresh_manifest(lens.folder, MACHINED)
    return MillingReport(
        folder=str(lens.folder),
        programs=tuple(programs),
        minutes=float(sum(each.minutes() for each in moves)),
        length_mm=float(sum(each.cutting_length_mm() for each in moves)),
        gouge_um=float(fit.gouge_mm * 1000),
        left_um=float(fit.left_mm * 1000),
        stated_um=float(fit.stated_mm * 1000),
        unreached_share=float(fit.unreached_share),
        unreached_um=float(fit.unreached_mm * 1000),
        faults=tuple(f"{name}: {text}" for name, program in programs.items() for text in faults(program)),
        psnr_db=psnr_db,
    )


def read_programs(plan: Plan, folder: Path) -> dict[str, MillingProgram]:
    """The milling programs of a run by the names of their files, in the order in which they run.

    Those of the first exporter that has written some: each exporter mills the whole lens.

    Args:
        plan: The plan of the run.
        folder: The run folder.

    Raises:
        InputError: No exporter of the plan has written one.
    """
    for step in plan.exporters:
        exporter = step.stage
        if isinstance(exporter, MillingExporter):
            with blaming(str(step)):
                files = exporter.program_files(folder / f"lens{exporter.suffix}")
                if files:
                    return {file.name: exporter.read_program(file) for file in files}
    wish = "there is no milling program; run its spec with --set 'pipeline.exporters=[{type: gcode}]'"
    raise InputError(wish, str(folder))


def _write_pictures(lens: OpenRun, programs: Sequence[MillingProgram]) -> dict[str, dict[str, float]]:
    """Trace the lens as designed, as cut and polished, and write what it shows; PSNR by view and state."""
    from magiclens.images.files import write_png
    from magiclens.images.score import score
    from magiclens.rendering.tracer import Tracer
    from magiclens.simulation.machining import seen_as_machined

    # the sources as they are printed, not as the spec gives them: an encoder may have painted them
    scene = lens.lit_scene
    cut, polished = seen_as_machined(scene, lens.solid, programs)
    with atomic_folder(lens.folder / MACHINED) as pictures:
        for k, view in enumerate(scene.views):
            write_png(pictures / f"{view.name}.png", cut[k])
            write_png(pictures / f"{view.name}-polished.png", polished[k])
    seen = {"designed": Tracer().render(scene, lens.solid), "as cut": cut, "polished": polished}
    return {
        view.name: {state: score(seen[state][k], view.target).psnr_db for state in seen}
        for k, view in enumerate(scene.views)
    }
