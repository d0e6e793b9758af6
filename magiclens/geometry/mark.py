"""The mark at the foot of a lens's upper side: which edge is up."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, Solid

MARK_WIDE_MM, MARK_OUT_MM = 3.0, 1.2
"""Width of the mark along the side, and how far it stands out at the foot; at the top it has tapered to nothing."""
_NEAR_MM = 1e-6
"""Points that are less than this apart along an axis are on one line."""


_Box = tuple[float, float, float, float]
"""Left, bottom, right and top of an upright rectangle, mm, lens frame."""


def with_mark(foot: FloatArray) -> FloatArray:
    """The outline of a lens's foot with a mark in the middle of its +y side.

    The mark is about ``MARK_WIDE_MM`` wide; where points are farther apart, the nearest ones alone are moved.

    Args:
        foot: (B, 3) points along a rectangle of z = 0, mm, lens frame.
    """
    left, _, right, top = _around(foot)
    aside = abs(foot[:, 0] - (left + right) / 2)
    above = foot[:, 1] > top - _NEAR_MM
    half = max(MARK_WIDE_MM / 2, float(aside[above].min()))
    out: FloatArray = foot + np.outer(above & (aside <= half + _NEAR_MM), (0.0, MARK_OUT_MM, 0.0))
    return out


def foot_of(points: FloatArray, marked: bool) -> _Box:
    """The rectangle on which a lens stands, without its mark.

    Args:
        points: (V, 2) or (V, 3) points of its bottom, corners among them, mm, lens frame.
        marked: Whether there is a mark, which begins inside of the corners.
    """
    if not marked:
        return _around(points)
    x = points[:, 0]
    return _around(points[(x < x.min() + _NEAR_MM) | (x > x.max() - _NEAR_MM)])


def mark_of(points: FloatArray) -> _Box:
    """The rectangle around the mark of a lens, beside its foot; arguments are those of ``foot_of``."""
    left, _, right, top = foot_of(points, marked=True)
    middle = (left + right) / 2
    half = float(abs(points[abs(points[:, 1] - top) < _NEAR_MM, 0] - middle).min())
    return middle - half, top, middle + half, float(points[:, 1].max())


def lowest_points(solid: Solid) -> FloatArray:
    """(V, 3) the vertices on which a solid stands."""
    z = solid.vertices[:, 2]
    found: FloatArray = solid.vertices[z <= z.min() + _NEAR_MM]
    return found


def _around(points: FloatArray) -> _Box:
    (left, bottom), (right, top) = points[:, :2].min(axis=0).tolist(), points[:, :2].max(axis=0).tolist()
    return left, bottom, right, top
