"""The kernel of the lens as milled: grey-scale dilation on a raster."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads


@njit(cache=True, nogil=True)
def _dilated_part(part, z, shape, out):
    """Part of the rows, see ``dilated``."""
    rows, columns = z.shape
    n = len(shape) // 2
    for row in range(part.first, part.end):
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


def dilated(z: FloatArray, shape: FloatArray) -> FloatArray:
    """out[i, j] = max over (a, b) of z[i + a, j + b] - shape[a + n, b + n].

    Args:
        z: (rows, columns) float32, mm.
        shape: (2 n + 1, 2 n + 1) float32, how high the cutter's surface is above its tip, mm; inf where it has none.
    """
    out = np.full_like(z, -np.inf)
    in_threads(_dilated_part, len(z), z, shape, out)
    return out
