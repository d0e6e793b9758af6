"""The kernel of the lens as milled: grey-scale dilation on a raster."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True)
def dilated(z, shape):
    """out[i, j] = max over (a, b) of z[i + a, j + b] - shape[a + n, b + n].

    Args:
        z: (rows, columns) float32, mm.
        shape: (2 n + 1, 2 n + 1) float32, how high the cutter's surface is above its tip, mm; inf where it has none.
    """
    rows, columns = z.shape
    n = len(shape) // 2
    out = np.full_like(z, -np.inf)
    for each in prange(rows):
        row = np.int64(each)  # prange counts unsigned
        line = out[row]
        for a in range(-n, n + 1):
            if not 0 <= row + a < rows:
                continue
            for b in range(-n, n + 1):
                rise = shape[a + n, b + n]
                if rise == np.inf:
                    continue
                for column in range(max(0, -b), min(columns, columns - b)):
                    line[column] = max(line[column], z[row + a, column + b] - rise)
    return out
