"""Heights in few bytes: every facet is a smooth lenslet, so a handful of polynomial coefficients holds its grid."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from magiclens.artifacts import FloatArray

FINEST_MM = 1e-5
"""Rounding of coefficients, as heights: tilts a micro-facet by less than its light can be followed to."""


@dataclass(frozen=True)
class Packed:
    """Integers (P, N, N), zlib-compressed with their four bytes apart, for the P pairs of degrees p + q <= degree.

    The pairs come as in ``for p in ..: for q in ..``. Times ``step`` the integers are coefficients, mm, of orthonormal
    polynomials over a facet's grid lines, of degree p from the top row down and q from left to right.
    """

    content: bytes
    degree: int
    step: float


def pack(heights_mm: FloatArray, most_bytes: int) -> Packed:
    """Pack (N, N, k, k) heights, as finely as ``most_bytes`` allow but no finer than ``FINEST_MM``."""
    k = heights_mm.shape[-1]
    basis = polynomials(k)
    coefficients = np.einsum("ijab,pa,qb->pqij", heights_mm, basis, basis, optimize=True)
    tolerance = FINEST_MM
    while len((packed := _rounded(coefficients, tolerance * k)).content) > most_bytes:
        tolerance *= 2
    return packed


def unpack(packed: Packed, facets: int, lines: int) -> FloatArray:
    """(N, N, k, k) float64 heights, mm; the viewer's script does the same."""
    basis = polynomials(lines)
    spread = np.frombuffer(zlib.decompress(packed.content), np.uint8).reshape(4, -1)
    planes = np.ascontiguousarray(spread.T).view("<i4").reshape(-1, facets, facets)
    coefficients = np.zeros((lines, lines, facets, facets))
    for plane, (p, q) in zip(planes, _pairs(packed.degree), strict=True):
        if max(p, q) < lines:
            coefficients[p, q] = plane * packed.step
    heights: FloatArray = np.einsum("pqij,pa,qb->ijab", coefficients, basis, basis, optimize=True)
    return heights


def polynomials(k: int) -> FloatArray:
    """(k, k): orthonormal polynomials over k evenly spaced points; row d has degree d and rises at the last point."""
    powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, k), k - 1)
    basis, upper = np.linalg.qr(powers)
    rows: FloatArray = (basis * np.sign(np.diag(upper))).T
    return rows


def _pairs(degree: int) -> list[tuple[int, int]]:
    return [(p, q) for p in range(degree + 1) for q in range(degree + 1 - p)]


def _rounded(coefficients: FloatArray, step: float) -> Packed:
    whole = np.rint(coefficients / step).astype("<i4")
    used = np.argwhere(np.abs(whole).max(axis=(2, 3)) > 0)
    degree = int(used.sum(axis=1).max(initial=0))
    lines = len(whole)
    planes = np.zeros((len(_pairs(degree)), *whole.shape[2:]), "<i4")
    for plane, (p, q) in zip(planes, _pairs(degree), strict=True):
        if max(p, q) < lines:
            plane[:] = whole[p, q]
    apart = planes.view(np.uint8).reshape(-1, 4).T.tobytes()
    return Packed(zlib.compress(apart, 9), degree, step)
