"""From traced samples to the rows of a sparse matrix, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True)
def gather(hits, rows, columns, per_mm, pointers, index, share):
    """Which source pixels each pixel of the picture draws from, and how much; hits: (R, R, S, 3), lens frame.

    A first call, without room for entries, leaves each picture pixel's number of them in ``pointers[1:]``; with these
    added up, a second call fills ``index`` and ``share``.
    """
    height, width, samples, _ = hits.shape
    for i in prange(height):
        found, weights = np.zeros(4 * samples, np.int32), np.zeros(4 * samples)
        for j in range(width):
            count = 0
            for k in range(samples):
                weight = hits[i, j, k, 2] / samples
                x, y = hits[i, j, k, 0] * per_mm, -hits[i, j, k, 1] * per_mm
                if weight == 0.0 or abs(x) > 0.5 * columns or abs(y) > 0.5 * rows:
                    continue
                x = min(max(x + 0.5 * columns - 0.5, 0.0), columns - 1.001)
                y = min(max(y + 0.5 * rows - 0.5, 0.0), rows - 1.001)
                ix, iy = int(x), int(y)
                fx, fy = x - ix, y - iy
                for corner in range(4):
                    right, below = corner & 1, corner >> 1
                    part = weight * (fx if right else 1.0 - fx) * (fy if below else 1.0 - fy)
                    if part > 0.0:
                        count = _add(found, weights, count, (iy + below) * columns + ix + right, part)
            pixel = i * width + j
            if len(index) == 0:
                pointers[pixel + 1] = count
            else:
                first = pointers[pixel]
                for n in range(count):
                    index[first + n], share[first + n] = found[n], weights[n]


@njit(cache=True)
def _add(found, weights, count, pixel, part):
    """Add to a pixel's weight in a list of ``count`` different pixels; returns how many there are then."""
    for n in range(count - 1, -1, -1):
        if found[n] == pixel:
            weights[n] += part
            return count
    found[count], weights[count] = pixel, part
    return count + 1
