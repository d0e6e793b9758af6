"""Which places of a height field are out of reach of what is steep, compiled: see ``Grid``."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads

STEEP = np.float32(-1e29)
"""What lies below this in ``below`` of a ``Grid`` is no height, but says that a cell is steep."""
_NOWHERE = np.float32(1e30)
"""Height of a cone that there is not; finite, so that a product with 0 is 0."""


@njit(cache=True, nogil=True)
def _tips_part(part, us, vs, ws, slope, least, lowest, tips):
    """Part of the rows, see ``cones``: the lowest, and minus the highest, vertex of each steep cell."""
    for r in range(part.first, part.end):
        tall = vs[r] - vs[r + 1]
        for c in range(len(us) - 1):
            wide = us[c + 1] - us[c]
            a, b, d, e = ws[r, c], ws[r, c + 1], ws[r + 1, c], ws[r + 1, c + 1]
            # along a way that is as long in u or in v, the larger of both, the surface rises by both slopes at most
            upper, lower = abs(b - a) * tall + abs(e - b) * wide, abs(e - d) * tall + abs(d - a) * wide
            if max(upper, lower) < slope * wide * tall and min(wide, tall) >= least:
                tips[0, r, c] = tips[1, r, c] = _NOWHERE
            else:
                tips[0, r, c] = min(min(a, b), min(d, e)) - lowest
                tips[1, r, c] = lowest - max(max(a, b), max(d, e))


@njit(cache=True, nogil=True)
def _cones_part(part, wide, tall, slope, tips, heights):
    """Some of the cell fields, see ``cones``: ``heights`` has those of the tips around each cell, and gets the cones'.

    Each pass takes what cells before have; as a cone rises by the width of every cell that lies between, at least.
    """
    rows, columns = heights.shape[1:]
    aslant = np.full(columns + 2, _NOWHERE)
    for k in range(part.first, part.end):
        for turn in range(2):
            way = 1 if turn == 0 else -1
            for i in range(rows):
                r = i if turn == 0 else rows - 1 - i
                line = heights[k, r]
                if i > 0:
                    past, rise = heights[k, r - way], slope * tall[r - way]
                    for c in range(columns):
                        aslant[c + 1] = past[c] + min(rise, slope * wide[c])
                    for c in range(columns):
                        line[c] = min(min(line[c], past[c] + rise), min(aslant[c], aslant[c + 2]))
                found = _NOWHERE
                for j in range(columns):
                    c = j if turn == 0 else columns - 1 - j
                    line[c] = min(line[c], found)
                    found = line[c] + slope * wide[c]
        for r in range(rows):
            for c in range(columns):
                if tips[k, r, c] < _NOWHERE:
                    heights[k, r, c] = -_NOWHERE


def cones(us: FloatArray, vs: FloatArray, ws: FloatArray, slope: float, least: float) -> tuple[FloatArray, FloatArray]:
    """``above`` and ``below`` of a ``Grid``.

    Args:
        us, vs: u and v of the grid's lines, mm.
        ws: w of the vertices.
        slope: in w over u and v together, from which on cells count as steep, and of the cones.
        least: width, in u or v, below which cells count as steep, too, mm.
    """
    lowest, wide, tall = ws.min(), np.diff(us).astype(np.float32), -np.diff(vs).astype(np.float32)
    tips = np.empty((2, len(tall), len(wide)), np.float32)
    in_threads(_tips_part, len(tall), us, vs, ws, slope, least, lowest, tips)
    heights = tips.copy()
    for axis in (1, 2):  # neighbours touch
        before = np.moveaxis(heights.copy(), axis, 0)
        after = np.moveaxis(heights, axis, 0)
        np.minimum(after[1:], before[:-1], out=after[1:])
        np.minimum(after[:-1], before[1:], out=after[:-1])
    in_threads(_cones_part, 2, wide, tall, np.float32(slope), tips, heights)
    return -heights[1], heights[0]
