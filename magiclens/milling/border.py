"""Where a solid's top begins and ends, seen from above."""

from __future__ import annotations

from magiclens.contract.artifacts import FloatArray, Solid

Rectangle = tuple[float, float, float, float]
"""Lowest and highest x, lowest and highest y."""


def top_of(solid: Solid) -> FloatArray:
    """(rows, columns, 3) vertices of the top of a solid that has a grid."""
    rows, columns = solid.grid or (0, 0)
    return solid.vertices[: rows * columns].reshape(rows, columns, 3)


def outer(solid: Solid) -> Rectangle:
    """The rectangle that holds all of the top."""
    top = top_of(solid)[..., :2]
    (x0, y0), (x1, y1) = top.min(axis=(0, 1)).tolist(), top.max(axis=(0, 1)).tolist()
    return x0, x1, y0, y1


def inner(solid: Solid) -> Rectangle:
    """The largest rectangle that is surely within the top, whose border leans with the rays it is cut along."""
    top = top_of(solid)[..., :2]
    sides = [top[:, 0], top[:, -1], top[0], top[-1]]
    left, right = (choose(sides, key=lambda side: float(side[:, 0].mean())) for choose in (min, max))
    down, up = (choose(sides, key=lambda side: float(side[:, 1].mean())) for choose in (min, max))
    return float(left[:, 0].max()), float(right[:, 0].min()), float(down[:, 1].max()), float(up[:, 1].min())
