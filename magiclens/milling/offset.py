"""Where a cutter's tip may go without cutting into a solid: grey-scale dilation of its surface by the cutter's shape.

The dilation, tip(p) = max over surface points q of z(q) - rise(|p - q|), is taken over the triangles themselves, not
over a raster of them, so that nothing falls between samples: a facet touches the cutter at one distance from its axis,
where the cutter is as steep as the facet; what remains is touched at edges that are not valleys. Undercuts need no
care, since the highest surface wins.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import FloatArray, IntArray, Solid
from magiclens.milling.border import Rectangle
from magiclens.milling.outline import distance_at, nearest, rise_at, touch
from magiclens.milling.rows import HAIR_MM, by_row

UPRIGHT = 1e-9
"""Faces whose unit normal has a smaller z are walls: only their edges can be touched from above."""
VALLEY_MM = 1e-9
"""An edge counts as a valley if the far corner of one of its faces is higher above the other's plane."""

class Contacts:
    """The parts of a solid that a cutter can touch from above.

    outline: see ``milling.outline``. covered: a rectangle without a hole in the solid, which makes it quicker: there, a
    cutter cannot get so deep that it touches what is far away.
    """

    def __init__(self, solid: Solid, outline: FloatArray, covered: Rectangle | None = None):
        vertices = np.ascontiguousarray(solid.vertices, np.float64)
        faces = _facing_up(vertices, solid.faces)
        self._outline = outline
        self._facets = _facets(vertices, faces, outline)
        self._edges = _edges(vertices, _ridges(vertices, faces))
        self._reach = np.full(len(self._edges), outline[5])
        if covered:
            self._reach = _shortened(self._reach, vertices, faces, self._edges, outline, covered)

    def tips(self, x_mm: FloatArray, y_mm: FloatArray, floor_mm: float) -> FloatArray:
        """(rows, columns) float64: the lowest z of the cutter's tip at every (x_mm[column], y_mm[row]), mm.

        x_mm: (columns,) ascending, evenly spaced. y_mm: (rows,) ascending. ``floor_mm`` is the lowest z of all, and
        what counts where there is no surface.
        """
        shifted = self._facets[:, 1:6:2]
        facets = by_row(shifted.min(axis=1), shifted.max(axis=1), y_mm, y_mm)
        ends = self._edges[:, [1, 4]]
        edges = by_row(ends.min(axis=1) - self._reach, ends.max(axis=1) + self._reach, y_mm, y_mm)
        step = (x_mm[-1] - x_mm[0]) / (len(x_mm) - 1) if len(x_mm) > 1 else 1.0
        z: FloatArray = _tips(
            self._outline, self._facets, *facets, self._edges, self._reach, *edges,
            float(x_mm[0]), float(step), len(x_mm), np.ascontiguousarray(y_mm, np.float64), floor_mm,
        )  # fmt: skip
        return z


def _facing_up(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Faces that can be seen from above, walls left out."""
    normal = _normals(vertices, faces)
    up: IntArray = faces[normal[:, 2] > UPRIGHT * np.linalg.norm(normal, axis=1)]
    return up


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals: FloatArray = np.cross(b - a, c - a)
    return normals


def _facets(vertices: FloatArray, faces: IntArray, outline: FloatArray) -> FloatArray:
    """(F, 9): each triangle moved so that it lies where the tip is when it touches: x, y of its corners, z of the
    first, slope in x and in y.
    """
    normal = _normals(vertices, faces)
    slope = -normal[:, :2] / normal[:, 2:]
    steepness = np.linalg.norm(slope, axis=1)
    way, rise = _touches(outline, steepness)
    shift = slope * (way / np.maximum(steepness, 1e-300))[:, None]
    corners = vertices[faces][:, :, :2] - shift[:, None]
    z = vertices[faces[:, 0], 2] - rise
    return np.column_stack([corners.reshape(-1, 6), z, slope])


def _ridges(vertices: FloatArray, faces: IntArray) -> IntArray:
    """(E, 2): edges of the faces, but for those that lie between two of them as the bottom of a valley."""
    start, end, far = faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel(), faces[:, [2, 0, 1]].T.ravel()
    owner = np.tile(np.arange(len(faces)), 3)
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    low, high, far, owner = low[order], high[order], far[order], owner[order]
    first = np.flatnonzero(np.r_[True, (np.diff(low) != 0) | (np.diff(high) != 0)])
    count = np.diff(np.r_[first, len(low)])
    pair = first[count == 2]
    normal = _normals(vertices, faces[owner[pair]])
    above = vertices[far[pair + 1]] - vertices[faces[owner[pair], 0]]
    rise = np.einsum("ij,ij->i", normal, above) / np.linalg.norm(normal, axis=1)
    valley = np.zeros(len(low), bool)
    valley[pair[rise > VALLEY_MM]] = True
    kept = first[~valley[first]]
    return np.column_stack([low[kept], high[kept]])


def _edges(vertices: FloatArray, ridges: IntArray) -> FloatArray:
    """(E, 6): x, y, z of the lower end and of the upper end of each edge."""
    ends = vertices[ridges]
    falling = ends[:, 0, 2] > ends[:, 1, 2]
    ends[falling] = ends[falling][:, ::-1]
    return ends.reshape(-1, 6)


def _shortened(
    reach: FloatArray, vertices: FloatArray, faces: IntArray, edges: FloatArray, outline: FloatArray, covered: Rectangle
) -> FloatArray:
    """(E,): how far from an edge the tip can be when they touch, since it must be above the surface there."""
    low, high = np.array(covered[::2]), np.array(covered[1::2])
    side = max(float(outline[5]) / 8, 0.1)
    count = np.maximum(((high - low) / side).astype(int) + 1, 1)
    lowest = _lowest(vertices, faces, low, side, np.full(count, np.inf))
    for _ in range(2):
        reach = _shorter(outline, edges, reach, lowest, low, high, side)
    return reach


@njit(cache=True)
def _touches(outline, steepness):
    """Per facet, distance from the axis at which it is touched, and the cutter's rise there."""
    way, rise = np.empty_like(steepness), np.empty_like(steepness)
    for k in range(len(steepness)):
        way[k] = touch(outline, steepness[k], 0.0) if steepness[k] > 0.0 else 0.0
        rise[k] = rise_at(outline, way[k])
    return way, rise


@njit(cache=True)
def _lowest(vertices, faces, low, side, out):
    """Per cell of a coarse raster, the lowest corner of all faces that may reach into it."""
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        z = min(a[2], b[2], c[2])
        left, right = (min(a[0], b[0], c[0]) - low[0]) / side, (max(a[0], b[0], c[0]) - low[0]) / side
        down, up = (min(a[1], b[1], c[1]) - low[1]) / side, (max(a[1], b[1], c[1]) - low[1]) / side
        for i in range(max(int(left), 0), min(int(right) + 1, out.shape[0])):
            for j in range(max(int(down), 0), min(int(up) + 1, out.shape[1])):
                out[i, j] = min(out[i, j], z)
    return out


@njit(cache=True, parallel=True)
def _shorter(outline, edges, reach, lowest, low, high, side):
    """Reaches again, knowing how deep the surface lies within those given, if all that is covered."""
    out = np.empty_like(reach)
    for e in prange(len(edges)):
        edge, r = edges[e], reach[e]
        out[e] = r
        left, right = min(edge[0], edge[3]) - r, max(edge[0], edge[3]) + r
        lower, upper = min(edge[1], edge[4]) - r, max(edge[1], edge[4]) + r
        if left < low[0] or right > high[0] or lower < low[1] or upper > high[1]:
            continue
        z = edge[2]
        for i in range(int((left - low[0]) / side), int((right - low[0]) / side) + 1):
            for j in range(int((lower - low[1]) / side), int((upper - low[1]) / side) + 1):
                z = min(z, lowest[i, j])
        out[e] = min(distance_at(outline, edge[5] - z), r)
    return out


@njit(cache=True, parallel=True)
def _tips(outline, facets, facet_row, facet, edges, reach, edge_row, edge, x0, dx, columns, y_mm, floor):
    z = np.full((len(y_mm), columns), floor)
    for row in prange(len(y_mm)):
        for k in range(facet_row[row], facet_row[row + 1]):
            _raise_to_facet(z[row], facets[facet[k]], x0, dx, y_mm[row])
        for k in range(edge_row[row], edge_row[row + 1]):
            _raise_to_edge(z[row], outline, edges[edge[k]], reach[edge[k]], x0, dx, y_mm[row])
    return z


@njit(cache=True)
def _raise_to_facet(z, facet, x0, dx, y):
    """Raise the tips of a row to a facet, which lies where the tip is when it touches it."""
    left, right = np.inf, -np.inf
    for k in range(3):
        ax, ay, bx, by = facet[2 * k], facet[2 * k + 1], facet[(2 * k + 2) % 6], facet[(2 * k + 3) % 6]
        if min(ay, by) - HAIR_MM <= y <= max(ay, by) + HAIR_MM:
            t = min(max((y - ay) / (by - ay), 0.0), 1.0) if ay != by else 0.0
            left, right = min(left, ax + t * (bx - ax)), max(right, ax + t * (bx - ax))
            if ay == by:
                left, right = min(left, bx), max(right, bx)
    first = max(int(np.ceil((left - HAIR_MM - x0) / dx)), 0) if left <= right else 1
    last = min(int(np.floor((right + HAIR_MM - x0) / dx)), len(z) - 1) if left <= right else 0
    for i in range(first, last + 1):
        z[i] = max(z[i], facet[6] + facet[7] * (x0 + i * dx - facet[0]) + facet[8] * (y - facet[1]))


@njit(cache=True)
def _raise_to_edge(z, outline, edge, reach, x0, dx, y):
    """Raise the tips of a row to an edge."""
    ex, ey = edge[3] - edge[0], edge[4] - edge[1]
    length = np.sqrt(ex * ex + ey * ey)
    flat = length == 0.0
    ex, ey = (1.0, 0.0) if flat else (ex / length, ey / length)
    slope = 0.0 if flat else (edge[5] - edge[2]) / length
    base = edge[5] if flat else edge[2]
    first = max(int(np.ceil((min(edge[0], edge[3]) - reach - x0) / dx)), 0)
    last = min(int(np.floor((max(edge[0], edge[3]) + reach - x0) / dx)), len(z) - 1)
    for i in range(first, last + 1):
        px, py = x0 + i * dx - edge[0], y - edge[1]
        d = abs(px * ey - py * ex)
        if d >= reach or edge[5] - rise_at(outline, d) <= z[i]:
            continue
        v, r = nearest(outline, slope, length, px * ex + py * ey, d)
        if r <= outline[5]:
            z[i] = max(z[i], base + slope * v - rise_at(outline, r))
