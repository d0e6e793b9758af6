"""Heights in few bytes: each facet as a sum of polynomials with rounded coefficients, as many as it has vertices.

Any facet can be written in this way. A smooth lenslet has few coefficients that differ from zero; where refinement has
turned the micro-facets one by one, most coefficients are still small. So one coding serves both.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import FloatArray

_COARSER = 2**0.5
"""Factor of the step from one try to the next, while the packed heights are too long."""


@dataclass(frozen=True)
class PackedHeights:
    """Rounded coefficients of all facets.

    ``content`` holds whole numbers (k, k, N, N), zlib-compressed. 0, -1, 1, -2, .. are written as 0, 1, 2, 3, .. in
    four bytes each: first the lowest bytes of all numbers, then the second ones, and so on. Times ``step``, mm, the
    numbers are the coefficients [p, q] of orthonormal polynomials over the k grid lines of a facet: of degree p from
    the top row down, and of degree q from left to right.
    """

    content: bytes
    step: float


def pack_heights(heights_mm: FloatArray, finest_mm: float, most_bytes: int) -> PackedHeights:
    """Pack the heights of all facets.

    Args:
        heights_mm: (N, N, k, k) heights, row 0 at +y.
        finest_mm: Step to which coefficients are rounded, if that fits.
        most_bytes: Greatest length of the content; coefficients are rounded more coarsely until it fits.
    """
    basis, step = orthonormal_polynomials(heights_mm.shape[-1]), finest_mm
    coefficients = np.einsum("ijab,pa,qb->pqij", heights_mm, basis, basis, optimize=True)
    while len(content := _compressed(np.rint(coefficients / step).astype("<i4"))) > most_bytes:
        step *= _COARSER
    return PackedHeights(content, step)


def unpack_heights(packed: PackedHeights, facets: int, lines: int) -> FloatArray:
    """Heights (N, N, k, k) float64, mm, of N facets and k grid lines a side; the viewer's script does the same."""
    apart = np.frombuffer(zlib.decompress(packed.content), np.uint8).reshape(4, -1)
    folded = np.ascontiguousarray(apart.T).view("<u4").astype(np.int64).reshape(lines, lines, facets, facets)
    whole, basis = folded >> 1 ^ -(folded & 1), orthonormal_polynomials(lines)
    heights: FloatArray = np.einsum("pqij,pa,qb->ijab", whole * packed.step, basis, basis, optimize=True)
    return heights


def orthonormal_polynomials(k: int) -> FloatArray:
    """Polynomials (k, k) over k evenly spaced points; row d has degree d and is positive at the last point."""
    # Gram-Schmidt, step by step as in the viewer's script: at high degrees another method would round differently
    x, rows = np.linspace(-1, 1, k), np.zeros((k, k))
    for degree in range(k):
        row = x * rows[degree - 1] if degree else np.ones(k)
        # twice, as once leaves rounding errors that grow with the degree
        for _ in range(2):
            row = row - rows.T @ (rows @ row)
        rows[degree] = row / np.linalg.norm(row)
    return rows


def _compressed(whole: np.ndarray) -> bytes:
    """Bytes of equal weight stand together, since most high bytes are zero and compress to nothing."""
    folded = np.ascontiguousarray(whole << 1 ^ whole >> 31)
    return zlib.compress(folded.view(np.uint8).reshape(-1, 4).T.tobytes())
