"""The setup sheet: what the person at the machine must know, as text."""

from __future__ import annotations

import math

from magiclens.contract.units import LENGTH
from magiclens.milling.job import Job
from magiclens.milling.options import MillingOptions
from magiclens.milling.program import MillingProgram, MillingSetup
from magiclens.milling.scallop import scallop_mm


def head_comments(job: Job, program: MillingProgram) -> list[str]:
    """The most important lines of the setup sheet, for the head of a program."""
    return ["magiclens, unit: millimetre", f"plate {_plate(job)}", *program.setup.to_text(), _way(program)]


def setup_sheet(options: MillingOptions, job: Job, names: list[str]) -> str:
    """The whole setup sheet of a job; ``read_setup`` reads from it what belongs to one program.

    Args:
        options: of the exporter.
        job: the programs.
        names: the file of each program.
    """
    tiles = len({program.setup.zero_mm for program in job.programs})
    lines = [
        "How to mill this lens",
        "",
        f"Plate: {_plate(job)}, of clear acrylic or glass, its faces parallel. Its sides stay as they are.",
        f"Depth: the lens reaches {job.depth_mm:.2f} mm below the plate's top.",
        "Zero: the middle of the lens is the middle of the plate; z = 0 is the plate's top.",
        "Axes: +x to the right and +y up as the viewer sees the lens.",
        f"Travel: {options.safe_height:g} mm above the plate.",
        f"Spindle: {options.spindle} turns per minute.",
        f"Feed: {options.feed:g} mm/min, plunging {options.plunge:g} mm/min.",
        *(_scallops(options, job) if "finishing" in options.cutters else []),
        "Milled surfaces are frosted: polish until the ridges are gone, and no more.",
        "'mlens machined' with the run's folder simulates these programs and shows what their lens will show.",
    ]
    if tiles > 1:
        lines += [
            "",
            f"The machine's bed is smaller than the lens, which is milled in {tiles} tiles. Each program has its own",
            "zero: mark these places on the plate's protective film and clamp it anew for each. z = 0 stays its top.",
        ]
    for name, program in zip(names, job.programs, strict=True):
        lines += ["", *_program(name, program)]
    return "\n".join([*lines, ""])


def read_setup(sheet: str, name: str) -> MillingSetup:
    """The setup of the program in file ``name``, as a setup sheet says. Raises InputError if it says nothing of it."""
    # paragraphs are separated by empty lines, and that of a program begins with the name of its file
    _, _, after = sheet.partition(f"\n\n{name}:\n")
    return MillingSetup.from_text(after.partition("\n\n")[0].splitlines())


def _program(name: str, program: MillingProgram) -> list[str]:
    points = program.moves.points
    (x0, y0, z0), (x1, y1, z1) = points.min(axis=0), points.max(axis=0)
    return [
        f"{name}:",
        *(f"  {line}" for line in program.setup.to_text()),
        f"  x from {x0:.2f} to {x1:.2f}, y from {y0:.2f} to {y1:.2f}, z from {z0:.2f} to {z1:.2f}",
        f"  {len(points)} moves, {_way(program)}",
    ]


def _plate(job: Job) -> str:
    return "{:.2f} x {:.2f} x {:.2f} mm".format(*job.plate_mm)


def _scallops(options: MillingOptions, job: Job) -> list[str]:
    outline = options.cutter.outline()
    flat, steep = (scallop_mm(outline, options.stepover, slope) * 1000 for slope in (0.0, job.slope))
    angle = math.degrees(math.atan(job.slope))
    return [
        f"Lines: every {LENGTH.text(options.stepover)} along {options.axis}.",
        f"Ridges between them: {flat:.2f} um on planes, {steep:.2f} um on slopes of {angle:.0f} degrees.",
    ]


def _way(program: MillingProgram) -> str:
    minutes, way_mm = program.moves.minutes(), program.moves.cutting_length_mm()
    return f"{way_mm / 1000:.1f} m of cutting, about {minutes // 60:.0f} h {minutes % 60:.0f} min"
