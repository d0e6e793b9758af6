"""Heights in few bytes: every facet as a sum of polynomials, as many as it has vertices, its coefficients rounded.

Any facet can be written so. Of a smooth lenslet only the first few coefficients differ from zero, and where refinement
has turned micro-facets one by one, most of the others still are small; so one coding serves both.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import FloatArray

COARSER = 2**0.5
"""From one try to the next when the packed heights are too long."""


@dataclass(frozen=True)
class Packed:
    """Integers (k, k, N, N), zlib-compressed: 0, -1, 1, -2, .. as 0, 1, 2, 3, .., lowest bytes first, then the second.

    Times ``step`` they are the coefficients [p, q], mm, of orthonormal polynomials over the k grid lines of a facet: of
    degree p from the top row down and q from left to right.
    """

    content: bytes
    step: float


def pack(heights_mm: FloatArray, finest_mm: float, most_bytes: int) -> Packed:
    """Pack (N, N, k, k) heights, coefficients rounded to ``finest_mm``, or more coarsely to fit into ``most_bytes``."""
    basis, step = polynomials(heights_mm.shape[-1]), finest_mm
    coefficients = np.einsum("ijab,pa,qb->pqij", heights_mm, basis, basis, optimize=True)
    while len(content := _compressed(np.rint(coefficients / step).astype("<i4"))) > most_bytes:
        step *= COARSER
    return Packed(content, step)


def unpack(packed: Packed, facets: int, lines: int) -> FloatArray:
    """(N, N, k, k) float64 heights, mm; the viewer's script does the same."""
    apart = np.frombuffer(zlib.decompress(packed.content), np.uint8).reshape(4, -1)
    folded = np.ascontiguousarray(apart.T).view("<u4").astype(np.int64).reshape(lines, lines, facets, facets)
    whole, basis = folded >> 1 ^ -(folded & 1), polynomials(lines)
    heights: FloatArray = np.einsum("pqij,pa,qb->ijab", whole * packed.step, basis, basis, optimize=True)
    return heights


def polynomials(k: int) -> FloatArray:
    """(k, k): orthonormal polynomials over k evenly spaced points; row d has degree d and rises at the last point.

    By Gram and Schmidt, step by step as in the viewer's script, lest the two differ where degrees are high.
    """
    x, rows = np.linspace(-1, 1, k), np.zeros((k, k))
    for degree in range(k):
        row = x * rows[degree - 1] if degree else np.ones(k)
        for _ in range(2):
            row = row - rows.T @ (rows @ row)
        rows[degree] = row / np.linalg.norm(row)
    return rows


def _compressed(whole: np.ndarray) -> bytes:
    folded = np.ascontiguousarray(whole << 1 ^ whole >> 31)
    return zlib.compress(folded.view(np.uint8).reshape(-1, 4).T.tobytes())
