"""Sparse matrices times pictures, in parallel: scipy's product uses one core, and a movie has many frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads


# no fastmath: code that was just compiled would give other last bits than the same code from numba's cache
@njit(cache=True, nogil=True)
def _times_part(part, pointers, columns, values, x, out):
    """Part of the rows, see ``times``."""
    for r in range(part.first, part.end):
        for k in range(pointers[r], pointers[r + 1]):
            for c in range(x.shape[1]):
                out[r, c] += values[k] * x[columns[k], c]


def times(pointers: NDArray[Any], columns: NDArray[Any], values: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    """A sparse matrix in compressed rows times pictures: ``out[r] = sum over k of values[k] * x[columns[k]]``.

    Args:
        pointers: (rows + 1,) where each row's entries start.
        columns: (entries,) column of each entry.
        values: (entries,) float32.
        x: (columns, C) float32.

    Returns:
        (rows, C) float32.
    """
    out = np.zeros((len(pointers) - 1, x.shape[1]), np.float32)
    in_threads(_times_part, len(out), pointers, columns, values, x, out)
    return out
