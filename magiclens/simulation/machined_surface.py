"""The surface that milling programs leave, and the best that a cutter could leave."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.milling.border import Rectangle, inner_rectangle, top_vertices
from magiclens.milling.cutter import Cutter
from magiclens.milling.offset import Contacts
from magiclens.milling.outline import Outline
from magiclens.milling.outline_kernels import distance_at
from magiclens.milling.program import MillingProgram
from magiclens.milling.sweep import swept


def machined_surface(programs: Sequence[MillingProgram], x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """What programs leave standing of a plate. The volume that the cutters sweep is exact at the points asked.

    Rapid moves cut nothing: ``faults`` finds those that would.

    Args:
        programs: in the order in which they run.
        x_mm: (columns,) ascending, lens frame.
        y_mm: (rows,) descending.

    Returns:
        (rows, columns) float64, z at every (x_mm[column], y_mm[row]), mm, lens frame.
    """
    rising = np.ascontiguousarray(y_mm[::-1])
    z = np.full((len(y_mm), len(x_mm)), programs[0].setup.zero_mm[2])
    for program in reversed(programs):  # the surface is the same in any order; the last cut leaves least to do
        for cutter, moves in reversed(program.cuts):
            across, radius = moves[:, :, 1], cutter.diameter / 2
            near = (across.min(axis=1) <= rising[-1] + radius) & (across.max(axis=1) >= rising[0] - radius)
            if near.any():
                z = swept(cutter.outline(), moves[near], x_mm, rising, z)
    return np.ascontiguousarray(z[::-1])


def reachable_surface(design: Solid, cutter: Cutter, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """What a cutter must leave standing, whatever its path, because of its shape.

    It is the grey-scale closing of the surface, by lines twice as dense as the grid. Where the cutter fits, it is the
    surface itself.

    Args:
        design: a solid with a grid, lens frame.
        cutter: of any shape.
        x_mm: (columns,) ascending, evenly spaced.
        y_mm: (rows,) descending, evenly spaced.

    Returns:
        (rows, columns) float64, mm, lens frame.
    """
    outline, floor = cutter.outline(), float(design.vertices[:, 2].min())
    reach = _reach(design, outline, Rectangle(x_mm[0], x_mm[-1], y_mm[-1], y_mm[0]))
    dx, dy = (x_mm[1] - x_mm[0]) / 2, (y_mm[0] - y_mm[1]) / 2
    columns = x_mm[0] + dx * np.arange(-math.ceil(reach / dx), 2 * len(x_mm) - 1 + math.ceil(reach / dx))
    rows = y_mm[-1] + dy * np.arange(-math.ceil(reach / dy), 2 * len(y_mm) - 1 + math.ceil(reach / dy))
    around = Rectangle(columns[0] - reach, columns[-1] + reach, rows[0] - reach, rows[-1] + reach)
    x0, x1, y0, y1 = inner_rectangle(design)
    covered = Rectangle(max(x0, around.x0), min(x1, around.x1), max(y0, around.y0), min(y1, around.y1))
    tips = Contacts(_part(design, around), outline, covered).tips(columns, rows, floor)
    x, y = np.meshgrid(columns, rows)
    points = np.stack([x, y, tips], axis=-1)
    moves = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
    z = swept(outline, moves, x_mm, np.ascontiguousarray(y_mm[::-1]), np.full((len(y_mm), len(x_mm)), tips.max()))
    return np.ascontiguousarray(z[::-1])


def _part(design: Solid, area: Rectangle) -> Solid:
    """The faces of a solid that lie over an area, or partly so."""
    x, y = design.vertices[design.faces, 0], design.vertices[design.faces, 1]
    near = (x.max(axis=1) >= area.x0) & (x.min(axis=1) <= area.x1)
    near &= (y.max(axis=1) >= area.y0) & (y.min(axis=1) <= area.y1)
    return Solid(design.vertices, design.faces[near])


def _reach(design: Solid, outline: Outline, area: Rectangle) -> float:
    """How far beside an area's points the parts of the design can be that a cutter touches there, mm.

    The cutter is no deeper than the lowest point nearby, so a part that is far away must be high to touch it.
    """
    reach, top = outline.radius, top_vertices(design).reshape(-1, 3)
    for _ in range(3):  # a shorter reach sees less depth, and so becomes shorter again
        x0, x1, y0, y1 = area.x0 - 2 * reach, area.x1 + 2 * reach, area.y0 - 2 * reach, area.y1 + 2 * reach
        near = (top[:, 0] >= x0) & (top[:, 0] <= x1) & (top[:, 1] >= y0) & (top[:, 1] <= y1)
        if near.any():
            deep = float(np.ptp(top[near, 2]))
            reach = min(reach, float(distance_at(outline, deep)) + outline.radius / 50)
    return reach
