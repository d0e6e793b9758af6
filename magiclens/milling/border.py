"""The border of a solid's top, seen from above."""

from __future__ import annotations

from typing import NamedTuple

from magiclens.contract.artifacts import FloatArray, Solid


class Rectangle(NamedTuple):
    """An upright rectangle in the xy plane: lowest and highest x, lowest and highest y, mm."""

    x0: float
    x1: float
    y0: float
    y1: float


def top_vertices(solid: Solid) -> FloatArray:
    """The vertices of the top of a solid that has a grid: (rows, columns, 3) float64, mm, lens frame."""
    rows, columns = solid.grid or (0, 0)
    return solid.vertices[: rows * columns].reshape(rows, columns, 3)


def outer_rectangle(solid: Solid) -> Rectangle:
    """The smallest rectangle that holds all of the top."""
    top = top_vertices(solid)[..., :2]
    (x0, y0), (x1, y1) = top.min(axis=(0, 1)).tolist(), top.max(axis=(0, 1)).tolist()
    return Rectangle(x0, x1, y0, y1)


def inner_rectangle(solid: Solid) -> Rectangle:
    """The largest rectangle that is surely within the top.

    Facets that are cut along eye rays lean, so the border of the top is not a rectangle itself.
    """
    top = top_vertices(solid)[..., :2]
    sides = [top[:, 0], top[:, -1], top[0], top[-1]]
    # a grid may be mirrored, so its sides are told apart by where they are, not by their index
    left, right = (choose(sides, key=lambda side: float(side[:, 0].mean())) for choose in (min, max))
    down, up = (choose(sides, key=lambda side: float(side[:, 1].mean())) for choose in (min, max))
    return Rectangle(float(left[:, 0].max()), float(right[:, 0].min()), float(down[:, 1].max()), float(up[:, 1].min()))
