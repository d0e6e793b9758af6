"""Kernels for what a cutter leaves that moves along straight lines."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.milling.outline import Outline
from magiclens.milling.outline_kernels import distance_at, rise_at, touch_segment
from magiclens.milling.row_index import RowIndex

BAND = 16
"""Number of rows that one thread cuts together."""
_BLOCK = 8
"""Number of columns whose highest point is remembered, so that moves that pass above all of them are skipped."""


class CutterMove(NamedTuple):
    """A straight move of the tip, from its lower end on.

    Args:
        x: of the lower end, mm.
        y: of the lower end, mm.
        z: of the lower end, mm.
        ex: x of the unit direction, seen from above.
        ey: y of it.
        length: seen from above, mm.
        slope: rise per length, at least 0.
        left: lowest x of the move, mm.
        right: highest x of the move, mm.
    """

    x: float
    y: float
    z: float
    ex: float
    ey: float
    length: float
    slope: float
    left: float
    right: float


@njit(cache=True)
def reaches(outline, lowest, top):
    """How far from a move the cutter can meet anything at all.

    Args:
        outline: the cutter's ``Outline``.
        lowest: (M,) lowest z of the tip in each move, mm.
        top: z of the highest material, mm.

    Returns:
        (M,) distances seen from above, mm; -1 where the whole move is above all material.
    """
    out = np.empty_like(lowest)
    for k in range(len(lowest)):
        out[k] = distance_at(outline, top - lowest[k]) if lowest[k] < top else -1.0
    return out


@njit(cache=True, nogil=True)
def _cut_part(part, outline, moves, reach, bands, x_mm, y_mm, z):
    """Part of the bands, see ``cut_grid``."""
    blocks = (len(x_mm) + _BLOCK - 1) // _BLOCK
    for band in range(part.first, part.end):
        first, last = band * BAND, min((band + 1) * BAND, len(y_mm))
        highest = np.empty((last - first, blocks))
        for row in range(first, last):
            for block in range(blocks):
                highest[row - first, block] = z[row, block * _BLOCK : (block + 1) * _BLOCK].max()
        count = bands.start[band + 1] - bands.start[band]
        for k in range(count):  # from the middle out: lines come in order, and near ones leave far ones nothing to cut
            n = bands.member[bands.start[band] + count // 2 + ((k + 1) // 2 if k % 2 == 0 else -(k + 1) // 2)]
            cut, r = _cut_along(moves[n]), reach[n]
            low, high = min(moves[n, 0, 1], moves[n, 1, 1]), max(moves[n, 0, 1], moves[n, 1, 1])
            for row in range(first, last):
                y = y_mm[row]
                beside = max(low - y, y - high, 0.0)
                if beside < r:
                    _cut_row(outline, cut, r, beside, x_mm, y, z[row], highest[row - first])


def cut_grid(
    outline: Outline,
    moves: FloatArray,
    reach: FloatArray,
    bands: RowIndex,
    x_mm: FloatArray,
    y_mm: FloatArray,
    z: FloatArray,
) -> None:
    """z(p) = min(z(p), min over all positions q of the tip of z(q) + rise(|p - q|)), at every point p of a grid.

    Args:
        outline: the cutter's ``Outline``.
        moves: (M, 2, 3) float64, lower and upper end of each move, mm.
        reach: (M,) how far from each move points are cut, mm.
        bands: the ``RowIndex`` of the moves over bands of ``BAND`` rows.
        x_mm, y_mm: (columns,) and (rows,) ascending.
        z: (rows, columns) float64, changed in place, mm.
    """
    in_threads(_cut_part, len(bands.start) - 1, outline, moves, reach, bands, x_mm, y_mm, z)


@njit(cache=True)
def _cut_along(move):
    """The ``CutterMove`` of a move (2, 3); an upright one points along x."""
    start, end = move[0], move[1]
    ex, ey = end[0] - start[0], end[1] - start[1]
    length = math.sqrt(ex * ex + ey * ey)
    left, right = min(start[0], end[0]), max(start[0], end[0])
    if length == 0.0:
        return CutterMove(start[0], start[1], start[2], 1.0, 0.0, 0.0, 0.0, left, right)
    slope = (end[2] - start[2]) / length
    return CutterMove(start[0], start[1], start[2], ex / length, ey / length, length, slope, left, right)


@njit(cache=True)
def _cut_row(outline, cut, reach, beside, x_mm, y, z, highest):
    """Cut one row of the grid, block by block: skip blocks with cut.z + rise(distance) >= the block's highest point.

    Args:
        outline: the cutter's ``Outline``.
        cut: the ``CutterMove``.
        reach: how far from the move points are cut, mm.
        beside: distance of the row from the y range of the move, mm, below ``reach``.
        x_mm: (columns,) ascending.
        y: of the row, mm.
        z: (columns,) heights of the row, mm, changed in place.
        highest: (blocks,) highest point of each block of the row, mm, changed in place.
    """
    half = math.sqrt(reach * reach - beside * beside)
    first, last = np.searchsorted(x_mm, cut.left - half), np.searchsorted(x_mm, cut.right + half, "right")
    for block in range(first // _BLOCK, (last + _BLOCK - 1) // _BLOCK):
        start, stop = block * _BLOCK, min((block + 1) * _BLOCK, len(x_mm))
        gap = max(x_mm[start] - cut.right, cut.left - x_mm[stop - 1], 0.0)
        distance = math.sqrt(gap * gap + beside * beside)
        if distance >= reach or cut.z + rise_at(outline, distance) >= highest[block]:
            continue
        for i in range(max(start, first), min(stop, last)):
            z[i] = min(z[i], _height_above(outline, cut, x_mm[i], y, reach, z[i]))
        highest[block] = z[start:stop].max()


@njit(cache=True)
def _height_above(outline, cut, x, y, reach, highest):
    """Height of the swept surface above (x, y), mm; inf where it is surely not below ``highest``.

    It is the least z(tip) + rise(distance) over all positions of the tip along the move. Counted backward from the
    move's upper end, that position is where, by ``touch_segment``, a cutter would touch a rising segment.
    """
    px, py = x - cut.x, y - cut.y
    d = abs(px * cut.ey - py * cut.ex)
    if d >= reach or cut.z + rise_at(outline, d) >= highest:
        return math.inf
    back, r = touch_segment(outline, cut.slope, cut.length, cut.length - (px * cut.ex + py * cut.ey), d)
    if r > outline.radius:
        return math.inf
    return cut.z + cut.slope * (cut.length - back) + rise_at(outline, r)
