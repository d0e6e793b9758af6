"""Where the pixels of a tile look at a source: the look-ups of a whole patch at once, before their colours are read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.sampling import clamped_cell


class Places(NamedTuple):
    """The look-ups of a tile, pixel by pixel, and what ``look`` fills in.

    Args:
        u, v: (K,) places in the facet that show what is looked up, mm from its centre.
        beside_x, beside_y: (K,) how far beside the patch's map of these places the look-ups are, source pixels.
        first: (K,) index, in a source's numbers (H, W, C), of the upper left of the four pixels around a look-up.
        right, below: (K,) float32, how far right and below of that pixel a look-up lies, from 0 to 1.
        light: (K,) float32, 1 on the source, and 0 beside it, where it is dark.
    """

    u: FloatArray
    v: FloatArray
    beside_x: FloatArray
    beside_y: FloatArray
    first: IntArray
    right: FloatArray
    below: FloatArray
    light: FloatArray


@njit(cache=True)
def places_for(count):
    """So many ``Places``, in the middle of a facet as yet."""
    points, weights = np.zeros((4, count)), np.zeros((3, count), np.float32)
    return Places(
        points[0], points[1], points[2], points[3], np.zeros(count, np.int64), weights[0], weights[1], weights[2]
    )


@njit(cache=True, fastmath=True)
def look(places, centre, m, per_mm, shape):
    """Fill in on which pixels of a source look-ups fall.

    Args:
        places: to fill in.
        centre: x, y that the facet's centre shows, mm from the source's centre.
        m: map of the patch (xx, xy, yy).
        per_mm: source pixels per mm.
        shape: rows, columns and channels of the source.
    """
    rows, columns, channels = shape
    x0, y0 = centre[0] * per_mm + 0.5 * columns - 0.5, centre[1] * per_mm + 0.5 * rows - 0.5
    xx, xy, yy = m[0] * per_mm, m[1] * per_mm, m[2] * per_mm
    for k in range(np.uint64(len(places.u))):
        u, v = places.u[k], places.v[k]
        x, y = x0 + xx * u + xy * v + places.beside_x[k], y0 + xy * u + yy * v + places.beside_y[k]
        inside = -0.5 <= x <= columns - 0.5 and -0.5 <= y <= rows - 0.5
        column, row, dx, dy = clamped_cell(x, y, columns, rows)
        places.first[k] = (row * columns + column) * channels
        places.right[k], places.below[k] = np.float32(dx), np.float32(dy)
        places.light[k] = np.float32(1.0) if inside else np.float32(0.0)
