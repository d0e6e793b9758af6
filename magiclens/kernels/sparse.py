"""Sparse matrices times pictures, in parallel: scipy's product uses one core, and a movie has many frames."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


# no fastmath: code that was just compiled would give other last bits than the same code from numba's cache
@njit(cache=True, parallel=True)
def times(pointers, columns, values, x):
    """A sparse matrix in compressed rows times pictures: ``out[r] = sum over k of values[k] * x[columns[k]]``.

    Args:
        pointers: (rows + 1,) where each row's entries start.
        columns: (entries,) column of each entry.
        values: (entries,) float32.
        x: (columns, C) float32.

    Returns:
        (rows, C) float32.
    """
    rows, channels = len(pointers) - 1, x.shape[1]
    out = np.zeros((rows, channels), np.float32)
    for r in prange(rows):
        for k in range(pointers[r], pointers[r + 1]):
            for c in range(channels):
                out[r, c] += values[k] * x[columns[k], c]
    return out
