"""A raster blurred by a Gaussian, compiled: for a narrow one that is quicker than transforms there and back."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads

_SIGMAS = 4.5
"""Where the Gaussian is cut off; beyond are some millionths of it."""


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def _across_part(part, z, weights, out):
    """Part of the rows, each blurred along itself."""
    columns, reach = z.shape[1], len(weights) - 1
    wide = np.empty(columns + 2 * reach, np.float32)
    for i in range(part.first, part.end):
        for j in range(columns):
            wide[reach + j] = z[i, j]
        for k in range(reach):
            wide[reach - 1 - k], wide[reach + columns + k] = z[i, k], z[i, columns - 1 - k]
        for j in range(columns):
            out[i, j] = weights[0] * wide[j + reach]
        for k in range(1, reach + 1):
            for j in range(columns):
                out[i, j] += weights[k] * (wide[j + reach - k] + wide[j + reach + k])


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def _down_part(part, z, weights, out):
    """Part of the rows, blurred across rows."""
    rows, columns = z.shape
    for i in range(part.first, part.end):
        for j in range(columns):
            out[i, j] = weights[0] * z[i, j]
        for k in range(1, len(weights)):
            above, below = i - k, i + k
            above, below = -1 - above if above < 0 else above, 2 * rows - 1 - below if below >= rows else below
            for j in range(columns):
                out[i, j] += weights[k] * (z[above, j] + z[below, j])


def spread_evenly(raster: FloatArray, sigma: float) -> FloatArray:
    """A raster (rows, columns) float32, blurred by a Gaussian and mirrored at its borders.

    Args:
        raster: What is blurred; on each side at least 4.5 sigma wide.
        sigma: In steps of the raster.
    """
    weights = np.exp(-0.5 * (np.arange(int(np.ceil(_SIGMAS * sigma)) + 1) / sigma) ** 2)
    weights = (weights / (weights[0] + 2 * weights[1:].sum())).astype(np.float32)
    between, out = np.empty_like(raster), np.empty_like(raster)
    in_threads(_across_part, len(raster), raster, weights, between)
    in_threads(_down_part, len(raster), between, weights, out)
    return out
