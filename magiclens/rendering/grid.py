"""The top of a solid as a height field over the reference plane, in coordinates in which its cells are upright.

Cells cut along eye rays become upright under the projective map (x, y, z) -> (u, v, w): (u, v) is where the line from
the cutting eye through the point meets the reference plane, and w = D / (eye_z - z), D the eye's distance from that
plane. The map keeps lines straight and planes flat, so rays and triangles may be intersected in (u, v, w)
exactly as in space. Vertical cells need no map: (u, v, w) = (x, y, z).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid
from magiclens.contract.errors import InputError
from magiclens.geometry.mark import foot_of
from magiclens.rendering.cone_kernels import cones

BLOCK_CELLS = 8
"""Cells along a side of the blocks whose heights are bounded, so that rays pass over them, or below, at little cost."""
_GENTLE = 2.0
"""Slope below which a cell counts as gentle: facets' are; rays that light follows into the glass fall more steeply."""
_NARROW = 0.5
"""Cells count as steep, too, if they are narrower than this share of an ordinary one: they belong to walls."""


class Grid(NamedTuple):
    """The regular grid of a solid's top, lens frame; flat, because numba hands no nested tuples to threads.

    Args:
        us: (columns,) u of the grid's lines, ascending, mm.
        vs: (rows,) v of the grid's lines, descending, mm.
        ws: (rows, columns) w of the vertices.
        lows: w of the lowest vertex of each block of ``BLOCK_CELLS`` x ``BLOCK_CELLS`` cells.
        highs: w of its highest vertex.
        lowest: w of the lowest vertex of all.
        gentlest: slope, in w over u and v together, below which cells count as gentle.
        above: (rows - 1, columns - 1) float32, for each gentle cell the height, in w from ``lowest``, from which on a
            line upward that is steeper than ``gentlest`` meets no steep cell; a great one for steep cells.
        below: the same, to which a line that falls has to come down; for steep cells it is minus a great one.
        points: (rows, columns, 3) the vertices in space, mm.
        cut_eye: (3,) the cutting eye, mm, or (0, 0, 0) for vertical cells.
        eye_distance: D, the cutting eye's distance from the reference plane, mm; 1 for vertical cells.
        vertical: whether cells are vertical.
        highest: z of the highest vertex, mm.
        floor_left: lowest x of the flat bottom, mm.
        floor_right: its highest x, mm.
        floor_bottom: its lowest y, mm.
        floor_top: its highest y, mm.
    """

    us: FloatArray
    vs: FloatArray
    ws: FloatArray
    lows: FloatArray
    highs: FloatArray
    lowest: float
    gentlest: float
    above: FloatArray
    below: FloatArray
    points: FloatArray
    cut_eye: FloatArray
    eye_distance: float
    vertical: bool
    highest: float
    floor_left: float
    floor_right: float
    floor_bottom: float
    floor_top: float

    @property
    def floor(self) -> tuple[float, float, float, float]:
        """Lowest and highest x, lowest and highest y of the flat bottom, mm; infinite if there is none."""
        return self.floor_left, self.floor_right, self.floor_bottom, self.floor_top


def grid_of(solid: Solid, lens: Lens) -> Grid:
    """The grid of a solid's top. Raises InputError if a finisher has turned it into a free mesh."""
    if solid.grid is None:
        raise InputError(
            "the built-in tracer needs the top's regular grid, which a finisher has removed; use mitsuba",
            keys=("pipeline.finisher",),
        )
    rows, columns = solid.grid
    points = solid.vertices[: rows * columns].reshape(rows, columns, 3)
    height_and_floor = float(points[..., 2].max()), *_floor(solid.vertices[rows * columns :], lens.mark)
    if solid.eye_mm is None:
        us, vs, ws = points[0, :, 0].copy(), points[:, 0, 1].copy(), points[..., 2].copy()
        bounds = *_bounds(ws), *_gentle(us, vs, ws, _GENTLE)
        return Grid(us, vs, ws, *bounds, points, np.zeros(3), 1.0, True, *height_and_floor)
    # a copy: to numba, arrays that are read-only are another type, for which it would compile the tracer again
    eye, distance = solid.eye_mm.copy(), float(solid.eye_mm[2] - lens.thickness_mm)
    w = distance / (eye[2] - points[..., 2])
    us = eye[0] + (points[0, :, 0] - eye[0]) * w[0]
    vs = eye[1] + (points[:, 0, 1] - eye[1]) * w[:, 0]
    # a slope in w is one in space over the eye's distance, near the reference plane
    bounds = *_bounds(w), *_gentle(us, vs, w, _GENTLE / distance)
    return Grid(us, vs, w, *bounds, points, eye, distance, False, *height_and_floor)


def _bounds(ws: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """``lows``, ``highs`` and ``lowest`` of a ``Grid``; vertices between blocks belong to both."""
    lows = highs = ws
    for axis in (0, 1):
        first = np.arange(0, ws.shape[axis] - 1, BLOCK_CELLS)
        border = np.minimum(first + BLOCK_CELLS, ws.shape[axis] - 1)
        lows = np.minimum(np.minimum.reduceat(lows, first, axis), lows.take(border, axis))
        highs = np.maximum(np.maximum.reduceat(highs, first, axis), highs.take(border, axis))
    return lows, highs, float(lows.min())


def _gentle(us: FloatArray, vs: FloatArray, ws: FloatArray, slope: float) -> tuple[float, FloatArray, FloatArray]:
    """``gentlest``, ``above`` and ``below`` of a ``Grid``."""
    least = _NARROW * max(np.median(np.diff(us)), np.median(-np.diff(vs)))
    return slope, *cones(us, vs, ws, slope, float(least))


def _floor(below: FloatArray, marked: bool) -> tuple[float, float, float, float]:
    """The rectangle that the vertices of sides and bottom span, without a mark; everything if there are none."""
    if not len(below):
        return -np.inf, np.inf, -np.inf, np.inf
    left, bottom, right, top = foot_of(below, marked)
    return left, right, bottom, top
