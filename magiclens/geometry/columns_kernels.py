"""Where vertical lines meet the triangles of a solid, compiled.

Triangles are filled row by row, between the points at which their edges cross the row's line y = const. A crossing is
always computed from an edge's lower end to its upper one, so the two triangles that share an edge agree on it to the
last bit: between them no line is missed, and none is counted twice.
"""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit


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
    """The two ends of the segment in which a triangle meets the plane at ``y``.

    Args:
        vertices: (V, 3) mm.
        a: index of the triangle's first corner.
        b: index of its second corner.
        c: index of its third corner.
        y: of the plane, mm.

    Returns:
        x and z of the left end, x and z of the right end, mm; the left x is inf where the triangle misses the plane.
    """
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
def highest(vertices, faces, x_mm, y_mm, first, last):
    """``z = left_z + (x - left) * slope`` between the ends of every triangle's segment in a row; the highest of all.

    Args:
        vertices: (V, 3) float64, mm.
        faces: (F, 3) indices of corners.
        x_mm: (columns,) ascending.
        y_mm: (rows,) descending.
        first: (V,) first row that is not above a vertex, see ``rows_at``.
        last: (V,) last row that is not below a vertex.

    Returns:
        (rows, columns) float32, mm; -inf where there is no triangle.
    """
    top = np.full((len(y_mm), len(x_mm)), -np.inf, np.float32)
    for f in range(len(faces)):
        a, b, c = faces[f]
        for row in range(min(first[a], first[b], first[c]), max(last[a], last[b], last[c]) + 1):
            left, left_z, right, right_z = span(vertices, a, b, c, y_mm[row])
            column = first_at(x_mm, left)
            slope = (right_z - left_z) / (right - left) if right > left else 0.0
            while column < len(x_mm) and x_mm[column] <= right:
                z = left_z + (x_mm[column] - left) * slope
                if z > top[row, column]:
                    top[row, column] = z
                column += 1
    return top
