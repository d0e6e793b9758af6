"""Decimation of single facets by edge collapse, compiled.

A vertex inside a facet is moved onto a neighbour, and the two triangles between them vanish, if the triangles that
change keep to the bound. Positions are whole numbers, column and row in the facet's grid of k x k vertices, in which
all questions of orientation and overlap have exact answers. A vertex lies on its ray, so seen along the rays the
surface is this plane triangulation, whatever its heights are.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit

_MOST_AROUND = 16
"""Most triangles about a vertex."""
_ROUNDS = (0.5, 0.75, 1.0, 1.0)
"""Shares of the tolerance that collapses may take: cheap ones first leave better triangles."""


class Surface(NamedTuple):
    """A facet as it was.

    Args:
        side: k, vertices along a side.
        points: (k * k, 3) mm.
        normals: (2 (k - 1)^2, 3) unit normals of its triangles, cell after cell as of ``top_faces``.
        width: Width of a cell, mm.
    """

    side: int
    points: FloatArray
    normals: FloatArray
    width: float


class Triangles(NamedTuple):
    """The triangles that are left.

    Args:
        corners: (F, 3) int32; -1 where a triangle has vanished.
        around: (k * k, 16) the triangles about every vertex.
        valence: (k * k,) how many these are.
    """

    corners: IntArray
    around: IntArray
    valence: IntArray


@njit(cache=True, nogil=True)
def _area(a, b, c, side):
    """Twice the area of a triangle of the grid; positive if it is counter-clockwise as the viewer sees it."""
    ax, ay, bx, by, cx, cy = a % side, a // side, b % side, b // side, c % side, c // side
    return (cx - ax) * (by - ay) - (bx - ax) * (cy - ay)  # rows go down


@njit(cache=True, nogil=True)
def _beyond(a, b, c, p, q, r, side):
    """Whether one side of a triangle has another triangle beyond it."""
    for start, end in ((a, b), (b, c), (c, a)):
        if max(_area(start, end, p, side), _area(start, end, q, side), _area(start, end, r, side)) <= 0:
            return True
    return False


@njit(cache=True, nogil=True)
def _normal(points, a, b, c):
    px, py, pz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    qx, qy, qz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    length = sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length


@njit(cache=True, nogil=True)
def _deviation(surface, a, b, c, most):
    """How far a triangle of the grid is from the facet as it was; inf once that is more than ``most``.

    The largest squared distance of its unit normal from those of the old triangles that it overlaps, or if that is
    more, the largest squared distance of an old vertex in it from its plane, in cells.
    """
    side, points, normals, width = surface
    nx, ny, nz = _normal(points, a, b, c)
    left, right = min(a % side, b % side, c % side), max(a % side, b % side, c % side)
    first, last = min(a, b, c) // side, max(a, b, c) // side
    worst = 0.0
    for row in range(first, last):
        for column in range(left, right):
            tl = row * side + column
            br = tl + side + 1
            for half in range(2):
                n = normals[2 * (row * (side - 1) + column) + half]
                off = (nx - n[0]) ** 2 + (ny - n[1]) ** 2 + (nz - n[2]) ** 2
                if off > worst:
                    q, r = (tl + side, br) if half == 0 else (br, tl + 1)
                    if not (_beyond(a, b, c, tl, q, r, side) or _beyond(tl, q, r, a, b, c, side)):
                        worst = off
                        if worst > most:
                            return np.inf
    for row in range(first, last + 1):
        for p in range(row * side + left, row * side + right + 1):
            x, y, z = points[p, 0] - points[a, 0], points[p, 1] - points[a, 1], points[p, 2] - points[a, 2]
            off = ((nx * x + ny * y + nz * z) / width) ** 2
            if off > worst and min(_area(a, b, p, side), _area(b, c, p, side), _area(c, a, p, side)) >= 0:
                worst = off
    return worst if worst <= most else np.inf


@njit(cache=True, nogil=True)
def _moved(corners, triangle, vertex, to):
    """A triangle's corners, where one of them is moved."""
    a, b, c = corners[triangle]
    return (to if a == vertex else a), (to if b == vertex else b), (to if c == vertex else c)


@njit(cache=True, nogil=True)
def _cost(surface, left, vertex, to, most):
    """The largest deviation of the triangles that change when a vertex is moved onto a neighbour; inf if it cannot."""
    if left.valence[vertex] + left.valence[to] - 2 > _MOST_AROUND:  # those that vanish are forgotten one by one
        return np.inf
    worst = 0.0
    for k in range(left.valence[vertex]):
        triangle = left.around[vertex, k]
        if to in left.corners[triangle]:
            continue
        a, b, c = _moved(left.corners, triangle, vertex, to)
        if _area(a, b, c, surface.side) <= 0:
            return np.inf
        worst = max(worst, _deviation(surface, a, b, c, most))
        if worst > most:
            return np.inf
    return worst


@njit(cache=True, nogil=True)
def _collapse(left, vertex, to):
    """Move a vertex onto a neighbour."""
    for k in range(left.valence[vertex]):
        triangle = left.around[vertex, k]
        if to in left.corners[triangle]:
            for corner in left.corners[triangle]:
                if corner != vertex:
                    _forget(left, corner, triangle)
            left.corners[triangle] = -1
        else:
            left.corners[triangle] = _moved(left.corners, triangle, vertex, to)
            left.around[to, left.valence[to]] = triangle
            left.valence[to] += 1
    left.valence[vertex] = 0


@njit(cache=True, nogil=True)
def _forget(left, vertex, triangle):
    """Take a triangle out of those about a vertex."""
    last = left.valence[vertex] - 1
    for k in range(last):
        if left.around[vertex, k] == triangle:
            left.around[vertex, k] = left.around[vertex, last]
    left.valence[vertex] = last


@njit(cache=True, nogil=True)
def _nearest(surface, left, vertex, most):
    """The neighbour onto which a vertex is moved at the least cost; -1 if all cost more than ``most``."""
    best = -1
    for k in range(left.valence[vertex]):
        triangle = left.corners[left.around[vertex, k]]
        # in a ring of triangles each neighbour follows the vertex once
        to = triangle[1] if triangle[0] == vertex else triangle[2] if triangle[1] == vertex else triangle[0]
        cost = _cost(surface, left, vertex, to, most)
        if cost < most or (best < 0 and cost == most):
            best, most = to, cost
    return best


@njit(cache=True, nogil=True)
def decimate(part, points, corners, tolerance, width):
    """Part of the facets; a vertex inside a facet goes if no normal then turns by more than the tolerance.

    Args:
        part: Which facets.
        points: (facets, k * k, 3) vertices of every facet, mm.
        corners: (facets, F, 3) int32 their triangles, of which those that vanish become -1.
        tolerance: Largest change of normals, radians, and of heights, in micro-facets.
        width: Width of a micro-facet, mm.
    """
    for f in range(part.first, part.end):
        side = round(sqrt(len(points[f])))
        normals = np.empty((len(corners[f]), 3))
        left = Triangles(corners[f], np.empty((side * side, _MOST_AROUND), np.int32), np.zeros(side * side, np.int32))
        for triangle in range(len(normals)):
            a, b, c = corners[f, triangle]
            normals[triangle] = _normal(points[f], a, b, c)
            for vertex in (a, b, c):
                left.around[vertex, left.valence[vertex]] = triangle
                left.valence[vertex] += 1
        surface = Surface(side, points[f], normals, width)
        for share in _ROUNDS:
            for row in range(1, side - 1):
                for vertex in range(row * side + 1, row * side + side - 1):
                    if left.valence[vertex] > 0:
                        to = _nearest(surface, left, vertex, (share * tolerance) ** 2)
                        if to >= 0:
                            _collapse(left, vertex, to)
