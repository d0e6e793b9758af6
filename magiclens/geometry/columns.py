"""Solids seen along z: where vertical lines meet them.

Triangles are filled row by row, between the points at which their edges cross the row's line y = const. A crossing is
always computed from an edge's lower end to its upper one, so the two triangles that share an edge agree on it to the
last bit: between them no line is missed, and none is counted twice.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from magiclens.contract.artifacts import FloatArray, IntArray, Solid


def top_relief(solid: Solid, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """(rows, columns) float32: z of the solid's highest point above every (x_mm[column], y_mm[row]), mm; NaN beside it.

    x_mm: (columns,) ascending, y_mm: (rows,) descending, lens frame. Triangles count with their borders and are met
    exactly, undercuts too: what overhangs hides what it overhangs. Raises ValueError if the lines are out of order.
    """
    if (np.diff(x_mm) <= 0).any() or (np.diff(y_mm) >= 0).any():
        raise ValueError("x_mm must ascend and y_mm descend")
    vertices = np.ascontiguousarray(solid.vertices, np.float64)
    first, last = rows_at(vertices, y_mm)
    z: FloatArray = _highest(vertices, solid.faces, np.asarray(x_mm, float), np.asarray(y_mm, float), first, last)
    z[np.isneginf(z)] = np.nan
    return z


def rows_at(vertices: FloatArray, y_mm: FloatArray) -> tuple[IntArray, IntArray]:
    """Per vertex, (V,) each: the first row that is not above it, and the last that is not below it."""
    down = -vertices[:, 1]
    return np.searchsorted(-y_mm, down, "left"), np.searchsorted(-y_mm, down, "right") - 1


@njit(cache=True)
def first_at(lines, value):
    """Index of the first of the ascending ``lines`` that is not below ``value``."""
    low, high = 0, len(lines)
    while low < high:
        middle = (low + high) // 2
        if lines[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True)
def _crossing(vertices, a, b, y):
    """x and z of the point at ``y`` of the edge between two vertices."""
    if vertices[a, 1] > vertices[b, 1]:
        a, b = b, a
    if y == vertices[b, 1]:
        return vertices[b, 0], vertices[b, 2]
    t = (y - vertices[a, 1]) / (vertices[b, 1] - vertices[a, 1])
    x = vertices[a, 0] + t * (vertices[b, 0] - vertices[a, 0])
    return x, vertices[a, 2] + t * (vertices[b, 2] - vertices[a, 2])


@njit(cache=True)
def span(vertices, a, b, c, y):
    """x and z of the left and of the right end of what a triangle has in common with the plane at ``y``."""
    left, right, left_z, right_z = np.inf, -np.inf, 0.0, 0.0
    for p, q in ((a, b), (b, c), (c, a)):
        if min(vertices[p, 1], vertices[q, 1]) <= y <= max(vertices[p, 1], vertices[q, 1]):
            x, z = _crossing(vertices, p, q, y)
            if x < left:
                left, left_z = x, z
            if x > right:
                right, right_z = x, z
    return left, left_z, right, right_z


@njit(cache=True)
def _highest(vertices, faces, x_mm, y_mm, first, last):
    """The highest z over all triangles; -inf where there is none."""
    highest = np.full((len(y_mm), len(x_mm)), -np.inf, np.float32)
    for f in range(len(faces)):
        a, b, c = faces[f]
        for row in range(min(first[a], first[b], first[c]), max(last[a], last[b], last[c]) + 1):
            left, left_z, right, right_z = span(vertices, a, b, c, y_mm[row])
            column = first_at(x_mm, left)
            slope = (right_z - left_z) / (right - left) if right > left else 0.0
            while column < len(x_mm) and x_mm[column] <= right:
                z = left_z + (x_mm[column] - left) * slope
                if z > highest[row, column]:
                    highest[row, column] = z
                column += 1
    return highest
