"""Milling programs run without a machine: the surface they leave, how it fits the design, and what is wrong.

Everything starts from written files: moves, cutters and zero are read back from them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from magiclens.contract.artifacts import FloatArray, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.geometry.columns import top_heights
from magiclens.geometry.solid import solid_from_raster
from magiclens.milling.border import Rectangle, inner, outer, top_of
from magiclens.milling.cutter import Cutter
from magiclens.milling.gcode import Gcode, gcode_comments, parse_gcode
from magiclens.milling.moves import Moves
from magiclens.milling.offset import Contacts
from magiclens.milling.outline import distance_at
from magiclens.milling.program import Facts, Program
from magiclens.milling.rml import Rml, parse_rml
from magiclens.milling.sheet import program_facts
from magiclens.milling.sweep import swept
from magiclens.simulation.strips import seen_in_strips

PER_STEPOVER = 4
"""Rows of the simulated surface from one line to the next."""
SEEN_ALONG, SEEN_ACROSS = 0.8, 0.5
"""Of a stepover, the raster's pitch where the surface is looked through. Only a whole number of rows to a line keeps
the ridges from beating with the raster."""
ALONG_MM = 0.05
MOST_POINTS = 24_000_000
TOUCHED_MM = 0.001
"""Where a cutter's shape leaves more than this standing, it does not reach the surface."""
PATCHES, PATCH_MM2 = (8, 32), 200.0
"""Least and most squares on which the fit is measured finely, and on how much of the lens there is one."""
PATCH_POINTS = 25
"""Points a side of such a square, a quarter of the stepover apart."""


@dataclass(frozen=True)
class Fit:
    """How a machined surface compares with the designed one, mm.

    gouge: most that was cut away, anywhere. left: most that lines and rounding leave above what the cutter's shape
    makes unavoidable; unreached: most that the shape makes unavoidable; unreached_share: of the area, where that is
    more than ``TOUCHED_MM``. The last three are measured on 8 to 32 small squares spread over the lens.
    stated: what the programs promise for ``left``.
    """

    gouge_mm: float
    left_mm: float
    unreached_mm: float
    unreached_share: float
    stated_mm: float


@dataclass(frozen=True)
class Machined:
    """What programs make of a plate, in the lens's frame, how it fits the design, and the programs.

    x_mm: (columns,) ascending, y_mm: (rows,) descending, z_mm: (rows, columns) of the surface: coarse along the lines.
    floor_mm: side of the design's flat bottom.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    floor_mm: float
    fit: Fit
    programs: tuple[Program, ...]

    @property
    def solid(self) -> Solid:
        """The surface as a closed body with vertical cells."""
        return solid_from_raster(self.x_mm, self.y_mm, self.z_mm, self.floor_mm)


def find_programs(folder: Path) -> list[Path]:
    """The milling programs of a run folder, G-code if it has both; empty if it has none."""
    for suffix in (Gcode.suffix, Rml.suffix):
        if (first := folder / f"lens{suffix}").is_file():
            others = sorted(folder.glob(f"lens-*{suffix}"), key=lambda path: int(path.stem.removeprefix("lens-")))
            return [first, *others]
    return []


def read_program(path: Path, cutters: Mapping[int, Cutter] | None = None) -> Program:
    """A program as it was written: G-code with its comments, RML-1 with the sheet beside it.

    ``cutters`` are used instead of those that the text names. Raises InputError at whatever is not understood.
    """
    try:
        text = path.read_text(encoding="utf-8")
        if path.suffix == Gcode.suffix:
            program = Program(parse_gcode(text), Facts.read(gcode_comments(text)))
        else:
            sheet = path.with_name(f"{path.stem.partition('-')[0]}{path.suffix}.txt")
            facts = program_facts(sheet.read_text(encoding="utf-8"), path.name)
            program = Program(parse_rml(text, min(facts.tools)), facts)
    except InputError as error:
        raise InputError(error.message, f"{path}, {error.where}" if error.where else str(path)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", str(path)) from None
    if cutters is None:
        return program
    used = {name: (number, cutters.get(number, old)) for name, (number, old) in program.facts.cutters.items()}
    return Program(program.moves, replace(program.facts, cutters=used))


def simulate(paths: Sequence[Path], design: Solid, cutters: Mapping[int, Cutter] | None = None) -> Machined:
    """Run programs, in order, on a fresh plate and compare with the design, a solid with a grid, lens frame.

    ``cutters`` by number are used instead of those that the files name. The surface has ``PER_STEPOVER`` rows or
    columns to a line of finishing. Raises InputError if a file is not understood.
    """
    programs = tuple(read_program(path, cutters) for path in paths)
    if design.grid is None or not programs:
        raise InputError("only programs for a lens whose top is a grid can be simulated")
    x, y = _raster(programs, design)
    z = machined_surface(programs, x, y)
    design_z = top_heights(design, x, y)
    gouge = max(float(np.nanmax(design_z - z)), 0.0)
    below = design.vertices[design.grid[0] * design.grid[1] :, :2]
    floor = 2 * float(np.abs(below).max()) if len(below) else 0.0
    return Machined(x, y, z, floor, _fit(programs, design, gouge), programs)


def machined_surface(programs: Sequence[Program], x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """(rows, columns) float64: what stands above every (x_mm[column], y_mm[row]), lens frame, mm.

    The volume that the cutters sweep is exact at these points. x_mm ascends, y_mm descends. Rapid moves cut nothing:
    see ``faults``.
    """
    rising = np.ascontiguousarray(y_mm[::-1])
    z = np.full((len(y_mm), len(x_mm)), programs[0].facts.zero_mm[2])
    for program in reversed(programs):  # the surface is the same in any order; the last cut leaves least to do
        for cutter, lines in reversed(program.cuts):
            across, radius = lines[:, [1, 4]], cutter.diameter / 2
            near = (across.min(axis=1) <= rising[-1] + radius) & (across.max(axis=1) >= rising[0] - radius)
            if near.any():
                z = swept(cutter.outline(), lines[near], x_mm, rising, z)
    return np.ascontiguousarray(z[::-1])


def reachable_surface(design: Solid, cutter: Cutter, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """(rows, columns) float64: what a cutter must leave standing, whatever its path, because of its shape.

    The grey-scale closing of the surface, by lines twice as dense as the grid, which is evenly spaced; x_mm ascends,
    y_mm descends. Where the cutter fits, this is the surface itself.
    """
    outline, floor = cutter.outline(), float(design.vertices[:, 2].min())
    reach = _reach(design, outline, (x_mm[0], x_mm[-1], y_mm[-1], y_mm[0]))
    dx, dy = (x_mm[1] - x_mm[0]) / 2, (y_mm[0] - y_mm[1]) / 2
    columns = x_mm[0] + dx * np.arange(-math.ceil(reach / dx), 2 * len(x_mm) - 1 + math.ceil(reach / dx))
    rows = y_mm[-1] + dy * np.arange(-math.ceil(reach / dy), 2 * len(y_mm) - 1 + math.ceil(reach / dy))
    around = columns[0] - reach, columns[-1] + reach, rows[0] - reach, rows[-1] + reach
    x0, x1, y0, y1 = inner(design)
    covered = max(x0, around[0]), min(x1, around[1]), max(y0, around[2]), min(y1, around[3])
    tips = Contacts(_part(design, around), outline, covered).tips(columns, rows, floor)
    x, y = np.meshgrid(columns, rows)
    points = np.stack([x, y, tips], axis=-1)
    lines = np.concatenate([points[:, :-1], points[:, 1:]], axis=-1).reshape(-1, 6)
    z = swept(outline, lines, x_mm, np.ascontiguousarray(y_mm[::-1]), np.full((len(y_mm), len(x_mm)), tips.max()))
    return np.ascontiguousarray(z[::-1])


def _part(design: Solid, area: Rectangle) -> Solid:
    """The faces of a solid that lie over an area, or partly so."""
    x, y = design.vertices[design.faces, 0], design.vertices[design.faces, 1]
    near = (x.max(axis=1) >= area[0]) & (x.min(axis=1) <= area[1])
    near &= (y.max(axis=1) >= area[2]) & (y.min(axis=1) <= area[3])
    return Solid(design.vertices, design.faces[near])


def _reach(design: Solid, outline: FloatArray, area: Rectangle) -> float:
    """How far beside an area's points what the cutter touches there can be, since nothing there is deeper."""
    reach, top = float(outline[5]), top_of(design).reshape(-1, 3)
    for _ in range(3):
        x0, x1, y0, y1 = area[0] - 2 * reach, area[1] + 2 * reach, area[2] - 2 * reach, area[3] + 2 * reach
        near = (top[:, 0] >= x0) & (top[:, 0] <= x1) & (top[:, 1] >= y0) & (top[:, 1] <= y1)
        if near.any():
            reach = min(reach, float(distance_at(outline, float(np.ptp(top[near, 2])))) + float(outline[5]) / 50)
    return reach


def _fit(programs: Sequence[Program], design: Solid, gouge_mm: float) -> Fit:
    """Fine comparisons on small squares; the last cutter has done the finishing."""
    cutter = list(programs[-1].facts.tools.values())[-1]
    side = _stepover(programs[-1].moves)[1] / PER_STEPOVER * (np.arange(PATCH_POINTS) - PATCH_POINTS // 2)
    x0, x1, y0, y1 = inner(design)
    low, high = np.array([x0, y0]), np.array([x1, y1])
    margin = np.minimum(float(cutter.outline()[5]) + side[-1], (high - low) / 4)
    unreached, left = [], []
    for k in range(int(np.clip((high - low).prod() / PATCH_MM2, *PATCHES))):
        # the R2 sequence (Roberts 2018) spreads points evenly
        share = (0.5 + (k + 1) * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
        x, y = low + margin + share * (high - low - 2 * margin)
        columns, rows = x + side, y - side
        reachable = reachable_surface(design, cutter, columns, rows)
        unreached.append(reachable - top_heights(design, columns, rows))
        left.append(float((machined_surface(programs, columns, rows) - reachable).max()))
    return Fit(
        gouge_mm,
        max(left),
        float(np.nanmax(unreached)),
        float((np.array(unreached) > TOUCHED_MM).mean()),
        max((p.facts.left_mm for p in programs if "finishing" in p.facts.cutters), default=np.inf),
    )


def _stepover(moves: Moves) -> tuple[int, float]:
    """Across which axis the longest lines of a program lie side by side, and how far apart."""
    lines = moves.lines()
    step = np.abs(lines[:, 3:5] - lines[:, :2])
    across = int(step[:, 0].sum() > step[:, 1].sum())
    last = moves.lines(int(moves.tool[-1]))
    gaps = np.diff(np.unique(np.round(last[:, across], 6)))
    return across, float(np.median(gaps)) if len(gaps) else ALONG_MM


def _raster(programs: Sequence[Program], design: Solid) -> tuple[FloatArray, FloatArray]:
    """x ascending and y descending of the simulated surface, over the whole of the design's top."""
    x0, x1, y0, y1 = outer(design)
    low, high = np.array([x0, y0]), np.array([x1, y1])
    across, stepover = _stepover(programs[-1].moves)
    pixel = np.full(2, max(min(stepover / PER_STEPOVER, ALONG_MM), float((high - low).max()) / MOST_POINTS**0.5 / 4))
    pixel[1 - across] = ALONG_MM
    count = np.ceil((high - low) / pixel).astype(int)
    if count.prod() > MOST_POINTS:
        count[1 - across] = MOST_POINTS // count[across]
    x, y = (np.linspace(low[k], high[k], count[k] + 1) for k in (0, 1))
    return x, np.ascontiguousarray(y[::-1])


def seen_as_machined(
    scene: Scene, design: Solid, programs: Sequence[Program]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Per view (R, R, C) float32, linear light: what eyes see of the lens as cut, and after polishing.

    Polishing, as a model, is a Gaussian over the heights that takes the ridges between the lines away: of a standard
    deviation of half the stepover, it leaves less than 1 % of them.
    """
    across, stepover = _stepover(programs[-1].moves)
    pixel = np.full(2, stepover * SEEN_ALONG)
    pixel[across] = stepover * SEEN_ACROSS
    sigma = stepover / 2 / pixel[::-1]
    margin = pixel[1] * np.arange(1, math.ceil(4 * sigma[0]) + 1)

    def surface(x: FloatArray, y: FloatArray) -> list[FloatArray]:
        z = machined_surface(programs, x, np.concatenate([y[0] + margin[::-1], y, y[-1] - margin]))
        own = slice(len(margin), len(margin) + len(y))
        return [z[own], gaussian_filter(z, sigma, mode="nearest")[own]]

    cut, polished = seen_in_strips(scene, design, surface, (float(pixel[0]), float(pixel[1])))
    return cut, polished


def faults(program: Program, bed_mm: tuple[float, float] | None = None) -> list[str]:
    """What would break cutters or leave the machine, in words; empty if nothing."""
    moves = program.moves
    z = moves.points[:, 2]
    before = np.r_[z[:1], z[:-1]]
    low = np.flatnonzero(moves.rapid & (np.minimum(before, z) < 0))
    found = [f"move {k} is rapid at z = {min(before[k], z[k]):.4f}, below the plate's top" for k in low[:1]]
    size = np.ptp(moves.points[:, :2], axis=0)
    if bed_mm and (size > np.array(bed_mm) + 1e-9).any():
        has = f"{bed_mm[0]:g} x {bed_mm[1]:g}"
        found.append(f"the moves span {size[0]:.2f} x {size[1]:.2f} mm, more than the bed of {has}")
    for number, cutter in program.facts.tools.items():
        deepest = -float(z[moves.tool == number].min(initial=0.0))
        if deepest > cutter.reach:
            found.append(f"cutter {number} goes {deepest:.4f} mm deep but reaches {cutter.reach:g}")
    return found
