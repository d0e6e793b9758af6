"""Milling programs run without a machine: how the surface they leave fits the design, what it shows, and what is wrong.

The programs are those that were read back from files: moves, cutters and zero are what a machine would be told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from magiclens.contract.artifacts import FloatArray, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.geometry.columns import top_heights
from magiclens.geometry.solid import solid_from_raster
from magiclens.milling.border import inner_rectangle, outer_rectangle
from magiclens.milling.program import MillingProgram
from magiclens.milling.toolpath import Moves
from magiclens.simulation.machined_surface import machined_surface, reachable_surface
from magiclens.simulation.strips import seen_in_strips

_PER_STEPOVER = 4
"""Number of rows of the simulated surface from one line to the next."""
_SEEN_ALONG, _SEEN_ACROSS = 0.8, 0.5
"""Pitch of the surface that eyes look through, in stepovers, along the lines and across them. Across, only a whole
number of rows to a line keeps the ridges from beating with the raster."""
_ALONG_MM = 0.05
"""Pitch of the simulated surface along the lines."""
_MOST_POINTS = 24_000_000
"""Most points of the simulated surface."""
_TOUCHED_MM = 0.001
"""Where a cutter's shape leaves more than this standing, it does not reach the surface."""
_PATCHES, _PATCH_MM2 = (8, 32), 200.0
"""Least and most squares on which the fit is measured finely, and the area of the lens for which there is one."""
_PATCH_POINTS = 25
"""Number of points along a side of such a square, a quarter of the stepover apart."""


@dataclass(frozen=True)
class SurfaceFit:
    """How a machined surface compares with the designed one, mm.

    gouge_mm: most that was cut away, anywhere. left_mm: most that lines and rounding leave above what the cutter's
    shape makes unavoidable; unreached_mm: most that the shape makes unavoidable; unreached_share: share of the area
    where that is more than a micrometre. The last three are measured on 8 to 32 small squares spread over the lens.
    stated_mm: what the programs promise for ``left_mm``.
    """

    gouge_mm: float
    left_mm: float
    unreached_mm: float
    unreached_share: float
    stated_mm: float


@dataclass(frozen=True)
class MachinedTop:
    """What programs make of a plate, in the lens's frame, how it fits the design, and the programs.

    x_mm: (columns,) ascending, y_mm: (rows,) descending, z_mm: (rows, columns) of the surface: coarse along the lines.
    floor_mm: side of the design's flat bottom.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    floor_mm: float
    fit: SurfaceFit
    programs: tuple[MillingProgram, ...]

    @property
    def solid(self) -> Solid:
        """The surface as a closed body with vertical cells."""
        return solid_from_raster(self.x_mm, self.y_mm, self.z_mm, self.floor_mm)


def run_programs(programs: Sequence[MillingProgram], design: Solid) -> MachinedTop:
    """Run programs, in order, on a fresh plate and compare the surface with the design.

    The surface has four rows or columns to a line of finishing.

    Args:
        programs: at least one.
        design: a solid with a grid, lens frame.

    Raises:
        InputError: the design has no grid, or there is no program.
    """
    if design.grid is None or not programs:
        raise InputError("only programs for a lens whose top is a grid can be simulated")
    x, y = _raster(programs, design)
    z = machined_surface(programs, x, y)
    design_z = top_heights(design, x, y)
    gouge = max(float(np.nanmax(design_z - z)), 0.0)
    below = design.vertices[design.grid[0] * design.grid[1] :, :2]
    floor = 2 * float(np.abs(below).max()) if len(below) else 0.0
    return MachinedTop(x, y, z, floor, _fit(programs, design, gouge), tuple(programs))


def _fit(programs: Sequence[MillingProgram], design: Solid, gouge_mm: float) -> SurfaceFit:
    """Fine comparisons on small squares; the last cutter has done the finishing."""
    cutter = list(programs[-1].setup.tools.values())[-1]
    side = _stepover(programs[-1].moves)[1] / _PER_STEPOVER * (np.arange(_PATCH_POINTS) - _PATCH_POINTS // 2)
    x0, x1, y0, y1 = inner_rectangle(design)
    low, high = np.array([x0, y0]), np.array([x1, y1])
    margin = np.minimum(cutter.outline().radius + side[-1], (high - low) / 4)
    unreached, left = [], []
    for k in range(int(np.clip((high - low).prod() / _PATCH_MM2, *_PATCHES))):
        # the R2 sequence (Roberts 2018) spreads points evenly
        share = (0.5 + (k + 1) * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
        x, y = low + margin + share * (high - low - 2 * margin)
        columns, rows = x + side, y - side
        reachable = reachable_surface(design, cutter, columns, rows)
        unreached.append(reachable - top_heights(design, columns, rows))
        left.append(float((machined_surface(programs, columns, rows) - reachable).max()))
    return SurfaceFit(
        gouge_mm,
        max(left),
        float(np.nanmax(unreached)),
        float((np.array(unreached) > _TOUCHED_MM).mean()),
        max((p.setup.left_mm for p in programs if "finishing" in p.setup.cutters), default=np.inf),
    )


def _stepover(moves: Moves) -> tuple[int, float]:
    """Across which axis (0 is x) the longest lines of a program lie side by side, and how far apart, mm."""
    cuts = moves.cutting()
    step = np.abs(cuts[:, 1, :2] - cuts[:, 0, :2])
    across = int(step[:, 0].sum() > step[:, 1].sum())
    last = moves.cutting(int(moves.tool[-1]))
    gaps = np.diff(np.unique(np.round(last[:, 0, across], 6)))
    return across, float(np.median(gaps)) if len(gaps) else _ALONG_MM


def _raster(programs: Sequence[MillingProgram], design: Solid) -> tuple[FloatArray, FloatArray]:
    """x ascending and y descending of the simulated surface, over the whole of the design's top."""
    x0, x1, y0, y1 = outer_rectangle(design)
    low, high = np.array([x0, y0]), np.array([x1, y1])
    across, stepover = _stepover(programs[-1].moves)
    pixel = np.full(2, max(min(stepover / _PER_STEPOVER, _ALONG_MM), float((high - low).max()) / _MOST_POINTS**0.5 / 4))
    pixel[1 - across] = _ALONG_MM
    count = np.ceil((high - low) / pixel).astype(int)
    if count.prod() > _MOST_POINTS:
        count[1 - across] = _MOST_POINTS // count[across]
    x, y = (np.linspace(low[k], high[k], count[k] + 1) for k in (0, 1))
    return x, np.ascontiguousarray(y[::-1])


def seen_as_machined(
    scene: Scene, design: Solid, programs: Sequence[MillingProgram]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """What eyes see of the lens as cut, and after polishing.

    Polishing, as a model, is a Gaussian over the heights that takes the ridges between the lines away: of a standard
    deviation of half the stepover, it leaves less than 1 % of them.

    Args:
        scene: the views.
        design: a solid with a grid, whose outline the machined lens keeps.
        programs: in the order in which they run.

    Returns:
        For either state, a picture per view: (R, R, C) float32, linear light, world frame.
    """
    across, stepover = _stepover(programs[-1].moves)
    pixel = np.full(2, stepover * _SEEN_ALONG)
    pixel[across] = stepover * _SEEN_ACROSS
    sigma = stepover / 2 / pixel[::-1]
    # rows beside a strip, so that the Gaussian sees what it would see of the whole surface
    margin = pixel[1] * np.arange(1, math.ceil(4 * sigma[0]) + 1)

    def surface(x: FloatArray, y: FloatArray) -> list[FloatArray]:
        z = machined_surface(programs, x, np.concatenate([y[0] + margin[::-1], y, y[-1] - margin]))
        own = slice(len(margin), len(margin) + len(y))
        return [z[own], gaussian_filter(z, sigma, mode="nearest")[own]]

    cut, polished = seen_in_strips(scene, design, surface, (float(pixel[0]), float(pixel[1])))
    return cut, polished


def faults(program: MillingProgram, bed_mm: tuple[float, float] | None = None) -> list[str]:
    """What would break cutters or leave the machine's bed (width, depth), in words; empty if nothing."""
    moves = program.moves
    z = moves.points[:, 2]
    before = np.r_[z[:1], z[:-1]]
    low = np.flatnonzero(moves.rapid & (np.minimum(before, z) < 0))
    found = [f"move {k} is rapid at z = {min(before[k], z[k]):.4f}, below the plate's top" for k in low[:1]]
    size = np.ptp(moves.points[:, :2], axis=0)
    if bed_mm and (size > np.array(bed_mm) + 1e-9).any():
        has = f"{bed_mm[0]:g} x {bed_mm[1]:g}"
        found.append(f"the moves span {size[0]:.2f} x {size[1]:.2f} mm, more than the bed of {has}")
    for number, cutter in program.setup.tools.items():
        deepest = -float(z[moves.tool == number].min(initial=0.0))
        if deepest > cutter.reach:
            found.append(f"cutter {number} goes {deepest:.4f} mm deep but reaches {cutter.reach:g}")
    return found
