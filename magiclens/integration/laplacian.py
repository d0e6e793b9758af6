"""The Laplacian of a grid of vertices with free borders: its right sides, and the transform that makes it diagonal."""

from __future__ import annotations

from functools import cache

import numpy as np

from magiclens.contract.artifacts import FloatArray


@cache
def cosines(k: int) -> tuple[FloatArray, FloatArray]:
    """The transform that makes the Laplacian of a grid with free borders diagonal, and its eigenvalues.

    Args:
        k: vertices along a side of the grid.

    Returns:
        The orthonormal DCT-II matrix (k, k), and the eigenvalues (k, k) by the frequencies along rows and columns, for
        a distance of 1 between vertices.
    """
    from scipy.fft import dct

    matrix = dct(np.eye(k), axis=0, norm="ortho")
    line = 2 - 2 * np.cos(np.pi * np.arange(k) / k)
    return matrix, line[:, None] + line[None, :]


def divergence(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Right side of the normal equations of the heights whose rises along edges are nearest to those asked for.

    Args:
        rows: (..., k, k - 1) rises from one column to the next, mm.
        columns: (..., k - 1, k) rises from one row to the next, mm.

    Returns:
        (..., k, k) at every vertex the rises toward it minus the rises away from it, mm.
    """
    out = np.zeros((*rows.shape[:-1], rows.shape[-1] + 1))
    out[..., :, 1:] += rows
    out[..., :, :-1] -= rows
    out[..., 1:, :] += columns
    out[..., :-1, :] -= columns
    return out
