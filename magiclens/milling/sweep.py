"""What a cutter that moves along straight lines leaves: the minimum over all its positions, exact at every point asked.

Above a point, the swept surface of one straight move is the minimum of a convex function of the way along the move, so
it is known in closed form from the cutter's outline (``milling.outline``).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from scipy.ndimage import maximum_filter

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.milling.outline import distance_at, nearest, rise_at
from magiclens.milling.rows import by_row

BAND = 16
"""Rows that one thread cuts together."""
NEAR = 0.05
"""Of the cutter's radius: how far the first pass looks."""
BLOCK = 8
"""Columns whose highest point is remembered, so that moves that pass above them are skipped."""


def swept(outline: FloatArray, moves: FloatArray, x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray) -> FloatArray:
    """(rows, columns) float64: the heights z_mm at (x_mm[column], y_mm[row]) after straight moves of a cutter's tip.

    moves: (M, 6) x, y, z from and to, mm. x_mm, y_mm ascending.
    """
    moves, reach = _prepared(outline, moves, float(z_mm.max()))
    first = np.arange(0, len(y_mm), BAND)
    last = np.minimum(first + BAND, len(y_mm)) - 1
    x, y, out = np.ascontiguousarray(x_mm), np.ascontiguousarray(y_mm), np.array(z_mm, np.float64, order="C")

    def cut(within: FloatArray) -> None:
        _cut_grid(outline, moves, within, *_by_band(moves, within, y[first], y[last]), x, y, out)

    cut(np.minimum(reach, NEAR * float(outline[5])))
    cut(_nearer(outline, moves, reach, x, y, out))  # what passed close by left so little that few others reach it
    return out


def _nearer(
    outline: FloatArray, moves: FloatArray, reach: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray
) -> FloatArray:
    """How far from moves the cutter meets anything, at most ``reach``, now that the heights z (rows, columns) are left.

    The highest point within the cutter's radius of a move, by cells of a coarse map, bounds what it can still cut.
    """
    radius = float(outline[5])
    cell, middle = radius / 4, (moves[:, :3] + moves[:, 3:]) / 2
    starts = [np.searchsorted(a, a[0] + cell * np.arange(int((a[-1] - a[0]) / cell) + 1)) for a in (y, x)]
    highest = np.maximum.reduceat(np.maximum.reduceat(z, starts[0], axis=0), starts[1], axis=1)
    highest = maximum_filter(highest, 2 * 7 + 1, mode="nearest")  # half a move, the radius, a cell
    row, column = (
        np.clip(((middle[:, axis] - a[0]) / cell).astype(int), 0, size - 1)
        for axis, a, size in zip((1, 0), (y, x), highest.shape, strict=True)
    )
    short = np.hypot(moves[:, 3] - moves[:, 0], moves[:, 4] - moves[:, 1]) < radius
    least = _reaches(outline, moves[:, 2] - highest[row, column], 0.0)
    return np.where(short, np.minimum(reach, least), reach)


def _prepared(outline: FloatArray, moves: FloatArray, top: float) -> tuple[FloatArray, FloatArray]:
    """Moves that begin at their lower end, and how far from them the cutter meets anything, mm."""
    moves = np.ascontiguousarray(moves, np.float64)
    falling = moves[:, 2] > moves[:, 5]
    moves = np.where(falling[:, None], moves[:, [3, 4, 5, 0, 1, 2]], moves)
    return moves, _reaches(outline, moves[:, 2], top)


def _by_band(moves: FloatArray, reach: FloatArray, low: FloatArray, high: FloatArray) -> tuple[IntArray, IntArray]:
    """For each band of rows, the moves that may meet it."""
    ends = moves[:, [1, 4]]
    return by_row(ends.min(axis=1) - reach, ends.max(axis=1) + reach, low, high)


@njit(cache=True)
def _reaches(outline, lowest, top):
    out = np.empty_like(lowest)
    for k in range(len(lowest)):
        out[k] = distance_at(outline, top - lowest[k]) if lowest[k] < top else -1.0
    return out


@njit(cache=True)
def _direction(move):
    """Unit direction seen from above, length seen from above, slope."""
    ex, ey = move[3] - move[0], move[4] - move[1]
    length = math.sqrt(ex * ex + ey * ey)
    if length == 0.0:
        return 1.0, 0.0, 0.0, 0.0
    return ex / length, ey / length, length, (move[5] - move[2]) / length


@njit(cache=True)
def _cut(outline, move, ex, ey, length, slope, x, y, reach, highest):
    """Height of the swept surface above (x, y); inf where it is not below ``highest`` for sure.

    Turned upside down, the cutter's surface climbs over the point as a slope climbs under a cutter.
    """
    px, py = x - move[0], y - move[1]
    d = abs(px * ey - py * ex)
    if d >= reach or move[2] + rise_at(outline, d) >= highest:
        return math.inf
    back, r = nearest(outline, slope, length, length - (px * ex + py * ey), d)
    if r > outline[5]:
        return math.inf
    return move[2] + slope * (length - back) + rise_at(outline, r)


@njit(cache=True, parallel=True)
def _cut_grid(outline, moves, reach, pointer, member, x_mm, y_mm, z):
    blocks = (len(x_mm) + BLOCK - 1) // BLOCK
    for band in prange(len(pointer) - 1):
        first, last = band * BAND, min((band + 1) * BAND, len(y_mm))
        highest = np.empty((last - first, blocks))
        for row in range(first, last):
            for block in range(blocks):
                highest[row - first, block] = z[row, block * BLOCK : (block + 1) * BLOCK].max()
        count = pointer[band + 1] - pointer[band]
        for k in range(count):  # from the middle out: lines come in order, and near ones leave far ones nothing to cut
            n = member[pointer[band] + count // 2 + ((k + 1) // 2 if k % 2 == 0 else -(k + 1) // 2)]
            move, r = moves[n], reach[n]
            ex, ey, length, slope = _direction(move)
            for row in range(first, last):
                y = y_mm[row]
                beside = max(min(move[1], move[4]) - y, y - max(move[1], move[4]), 0.0)
                if beside < r:
                    _cut_row(outline, move, ex, ey, length, slope, r, beside, x_mm, y, z[row], highest[row - first])


@njit(cache=True)
def _cut_row(outline, move, ex, ey, length, slope, reach, beside, x_mm, y, z, highest):
    """Cut one row of the grid, block by block."""
    half = math.sqrt(reach * reach - beside * beside)
    left, right = min(move[0], move[3]), max(move[0], move[3])
    first, last = np.searchsorted(x_mm, left - half), np.searchsorted(x_mm, right + half, "right")
    for block in range(first // BLOCK, (last + BLOCK - 1) // BLOCK):
        start, stop = block * BLOCK, min((block + 1) * BLOCK, len(x_mm))
        gap = max(x_mm[start] - right, left - x_mm[stop - 1], 0.0)
        distance = math.sqrt(gap * gap + beside * beside)
        if distance >= reach or move[2] + rise_at(outline, distance) >= highest[block]:
            continue
        for i in range(max(start, first), min(stop, last)):
            z[i] = min(z[i], _cut(outline, move, ex, ey, length, slope, x_mm[i], y, reach, z[i]))
        highest[block] = z[start:stop].max()
