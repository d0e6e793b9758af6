"""What a cutter leaves that moves along straight lines: the minimum over all its positions, exact at every point asked.

Above a point, the swept surface of one straight move is the minimum of a convex function of the way along the move, so
it is known in closed form from the cutter's outline.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

from magiclens.contract.artifacts import FloatArray
from magiclens.milling.outline import Outline
from magiclens.milling.row_index import RowIndex, index_rows
from magiclens.milling.sweep_kernels import BAND, cut_grid, reaches

_NEAR = 0.05
"""Reach of the first of two passes over all moves, in radii of the cutter; after it, few moves meet anything."""


def swept(outline: Outline, moves: FloatArray, x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray) -> FloatArray:
    """Heights after straight moves of a cutter.

    Args:
        outline: the cutter's.
        moves: (M, 2, 3) float64, from and to where the tip moves, mm.
        x_mm, y_mm: (columns,) and (rows,) ascending, in the same frame.
        z_mm: (rows, columns) heights before.

    Returns:
        (rows, columns) float64, mm.
    """
    moves = _rising(moves)
    reach = reaches(outline, moves[:, 0, 2], float(z_mm.max()))
    first = np.arange(0, len(y_mm), BAND)
    last = np.minimum(first + BAND, len(y_mm)) - 1
    x, y, out = np.ascontiguousarray(x_mm), np.ascontiguousarray(y_mm), np.array(z_mm, np.float64, order="C")

    def cut(within: FloatArray) -> None:
        cut_grid(outline, moves, within, _by_band(moves, within, y[first], y[last]), x, y, out)

    cut(np.minimum(reach, _NEAR * outline.radius))
    cut(_nearer(outline, moves, reach, x, y, out))  # what passed close by left so little that few others reach it
    return out


def _nearer(
    outline: Outline, moves: FloatArray, reach: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray
) -> FloatArray:
    """(M,) how far from moves the cutter meets anything, at most ``reach``, now that the heights z are left.

    The highest point within the cutter's radius of a move, by cells of a coarse map, bounds what it can still cut.
    """
    # starts: first row and column of each cell; reduceat takes the maximum from one start to the next
    cell, middle = outline.radius / 4, (moves[:, 0] + moves[:, 1]) / 2
    starts = [np.searchsorted(a, a[0] + cell * np.arange(int((a[-1] - a[0]) / cell) + 1)) for a in (y, x)]
    # a last cell that begins at the last point may begin after it, by rounding
    first_row, first_column = (np.minimum(start, len(a) - 1) for start, a in zip(starts, (y, x), strict=True))
    highest = np.maximum.reduceat(np.maximum.reduceat(z, first_row, axis=0), first_column, axis=1)
    # a point that a short move can cut is within 7 cells of its middle: half the move, the radius, one for rounding
    highest = maximum_filter(highest, 2 * 7 + 1, mode="nearest")
    row, column = (
        np.clip(((middle[:, axis] - a[0]) / cell).astype(int), 0, size - 1)
        for axis, a, size in zip((1, 0), (y, x), highest.shape, strict=True)
    )
    way = moves[:, 1] - moves[:, 0]
    short = np.hypot(way[:, 0], way[:, 1]) < outline.radius
    least = reaches(outline, moves[:, 0, 2] - highest[row, column], 0.0)
    return np.where(short, np.minimum(reach, least), reach)


def _rising(moves: FloatArray) -> FloatArray:
    """The moves from their lower end to their upper one: what they cut is the same either way."""
    moves = np.ascontiguousarray(moves, np.float64)
    falling = moves[:, 0, 2] > moves[:, 1, 2]
    return np.where(falling[:, None, None], moves[:, ::-1], moves)


def _by_band(moves: FloatArray, reach: FloatArray, low: FloatArray, high: FloatArray) -> RowIndex:
    """For each band of rows, from ``low`` to ``high``, the moves that may meet it."""
    ends = moves[:, :, 1]
    return index_rows(ends.min(axis=1) - reach, ends.max(axis=1) + reach, low, high)
