"""Kernels for the offset surface: the lowest tip of a cutter over triangles and edges.

"Face" is a triangle of the mesh here; a facet of the lens consists of many.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.milling.outline import Outline
from magiclens.milling.outline_kernels import distance_at, rise_at, touch, touch_segment
from magiclens.milling.row_index import HAIR_MM, RowIndex


class OffsetFaces(NamedTuple):
    """Triangles moved to where the tip is while the cutter touches them.

    Args:
        corners: (F, 3, 2) x and y of their corners, mm.
        z: (F,) height of the tip at the first corner, mm.
        slope: (F, 2) of the triangle along x and along y.
    """

    corners: FloatArray
    z: FloatArray
    slope: FloatArray


class TouchableEdges(NamedTuple):
    """Edges of the mesh that a cutter can touch.

    Args:
        low: (E, 3) their lower end, mm.
        high: (E, 3) their upper end, mm.
        reach: (E,) how far from the edge, seen from above, the tip can be while they touch, mm.
    """

    low: FloatArray
    high: FloatArray
    reach: FloatArray


class TipRaster(NamedTuple):
    """Points at which tips are asked for: x = x0 + dx * column, y = y_mm[row].

    Args:
        x0: x of the first column, mm.
        dx: distance of columns, mm.
        columns: number of columns.
        y_mm: (rows,) ascending.
    """

    x0: float
    dx: float
    columns: int
    y_mm: FloatArray


class DepthMap(NamedTuple):
    """The lowest corner of all faces that may reach into each cell of a coarse map.

    Args:
        z: (nx, ny) mm; inf where there is no face.
        low: (2,) x and y of the map's lower left corner, mm.
        high: (2,) x and y of its upper right corner, mm.
        side: side of a cell, mm.
    """

    z: FloatArray
    low: FloatArray
    high: FloatArray
    side: float


@njit(cache=True)
def touches(outline, steepness):
    """For each slope (F,), the distance from its axis at which the cutter touches it, and the cutter's rise there."""
    way, rise = np.empty_like(steepness), np.empty_like(steepness)
    for k in range(len(steepness)):
        way[k] = touch(outline, steepness[k], 0.0) if steepness[k] > 0.0 else 0.0
        rise[k] = rise_at(outline, way[k])
    return way, rise


@njit(cache=True)
def fill_depths(vertices, faces, depths):
    """Lower each cell of a ``DepthMap`` to the lowest corner of every face whose box reaches into it."""
    z, low, side = depths.z, depths.low, depths.side
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        lowest = min(a[2], b[2], c[2])
        left, right = (min(a[0], b[0], c[0]) - low[0]) / side, (max(a[0], b[0], c[0]) - low[0]) / side
        down, up = (min(a[1], b[1], c[1]) - low[1]) / side, (max(a[1], b[1], c[1]) - low[1]) / side
        for i in range(max(int(left), 0), min(int(right) + 1, z.shape[0])):
            for j in range(max(int(down), 0), min(int(up) + 1, z.shape[1])):
                z[i, j] = min(z[i, j], lowest)


@njit(cache=True, nogil=True)
def _shortened_part(part, outline, edges, depths, out):
    """Part of the edges, see ``shortened``."""
    low, high, side = depths.low, depths.high, depths.side
    for e in range(part.first, part.end):
        a, b, r = edges.low[e], edges.high[e], edges.reach[e]
        out[e] = r
        left, right = min(a[0], b[0]) - r, max(a[0], b[0]) + r
        lower, upper = min(a[1], b[1]) - r, max(a[1], b[1]) + r
        if left < low[0] or right > high[0] or lower < low[1] or upper > high[1]:
            continue
        z = a[2]
        for i in range(int((left - low[0]) / side), int((right - low[0]) / side) + 1):
            for j in range(int((lower - low[1]) / side), int((upper - low[1]) / side) + 1):
                z = min(z, depths.z[i, j])
        out[e] = min(distance_at(outline, b[2] - z), r)


def shortened(outline: Outline, edges: TouchableEdges, depths: DepthMap) -> FloatArray:
    """(E,) reaches of edges, shortened: reach = distance(z_upper - min z), min over all cells within the old reach.

    At the distance r from an edge the cutter's surface is rise(r) above the tip, and the tip is not below the lowest
    surface near the edge. So they can only touch where rise(r) <= z_upper - min z. Edges whose old reach leaves
    the map keep it: nothing is known of what lies beside the solid.
    """
    out = np.empty_like(edges.reach)
    in_threads(_shortened_part, len(out), outline, edges, depths, out)
    return out


@njit(cache=True, nogil=True)
def _lowest_tips_part(part, outline, faces_by_row, edges_by_row, raster, z):
    """Part of the rows, see ``lowest_tips``; what is there, and its ``RowIndex``."""
    (faces, face_rows), (edges, edge_rows) = faces_by_row, edges_by_row
    for row in range(part.first, part.end):
        y = raster.y_mm[row]
        for k in range(face_rows.start[row], face_rows.start[row + 1]):
            f = face_rows.member[k]
            _raise_to_face(z[row], faces.corners[f], faces.z[f], faces.slope[f], raster, y)
        for k in range(edge_rows.start[row], edge_rows.start[row + 1]):
            e = edge_rows.member[k]
            _raise_to_edge(z[row], outline, edges.low[e], edges.high[e], edges.reach[e], raster, y)


def lowest_tips(
    outline: Outline,
    faces: OffsetFaces,
    face_rows: RowIndex,
    edges: TouchableEdges,
    edge_rows: RowIndex,
    raster: TipRaster,
    floor: float,
) -> FloatArray:
    """tip(p) = max over surface points q of z(q) - rise(|p - q|), at every point p of the raster.

    Args:
        outline: the cutter's ``Outline``.
        faces, edges: ``OffsetFaces`` and ``TouchableEdges``.
        face_rows, edge_rows: the ``RowIndex`` of each over the rows of the raster.
        raster: a ``TipRaster``.
        floor: z where there is no surface, mm.

    Returns:
        (rows, columns) float64, mm.
    """
    z = np.full((len(raster.y_mm), raster.columns), floor)
    in_threads(_lowest_tips_part, len(z), outline, (faces, face_rows), (edges, edge_rows), raster, z)
    return z


@njit(cache=True)
def _raise_to_face(z, corners, base, slope, raster, y):
    """Raise the tips z of a row to a face: base + slope . (p - first corner) between its borders on the row."""
    x0, dx = raster.x0, raster.dx
    left, right = np.inf, -np.inf
    for k in range(3):
        ax, ay, bx, by = corners[k, 0], corners[k, 1], corners[(k + 1) % 3, 0], corners[(k + 1) % 3, 1]
        if min(ay, by) - HAIR_MM <= y <= max(ay, by) + HAIR_MM:
            t = min(max((y - ay) / (by - ay), 0.0), 1.0) if ay != by else 0.0
            left, right = min(left, ax + t * (bx - ax)), max(right, ax + t * (bx - ax))
            if ay == by:  # the whole edge lies on the row, so its other end counts too
                left, right = min(left, bx), max(right, bx)
    # 1 and 0: no column at all
    first = max(int(np.ceil((left - HAIR_MM - x0) / dx)), 0) if left <= right else 1
    last = min(int(np.floor((right + HAIR_MM - x0) / dx)), len(z) - 1) if left <= right else 0
    for i in range(first, last + 1):
        z[i] = max(z[i], base + slope[0] * (x0 + i * dx - corners[0, 0]) + slope[1] * (y - corners[0, 1]))


@njit(cache=True)
def _raise_to_edge(z, outline, low, high, reach, raster, y):
    """Raise the tips z of a row to an edge: z(v) - rise(r) at the point of the edge that the cutter touches.

    v is the way along the edge and r that point's distance from the cutter's axis, see ``touch_segment``.
    """
    x0, dx = raster.x0, raster.dx
    ex, ey = high[0] - low[0], high[1] - low[1]
    length = np.sqrt(ex * ex + ey * ey)
    upright = length == 0.0
    ex, ey = (1.0, 0.0) if upright else (ex / length, ey / length)
    slope = 0.0 if upright else (high[2] - low[2]) / length
    base = high[2] if upright else low[2]
    first = max(int(np.ceil((min(low[0], high[0]) - reach - x0) / dx)), 0)
    last = min(int(np.floor((max(low[0], high[0]) + reach - x0) / dx)), len(z) - 1)
    for i in range(first, last + 1):
        px, py = x0 + i * dx - low[0], y - low[1]
        d = abs(px * ey - py * ex)
        # even the edge's upper end, touched as near as this, would not raise the tip
        if d >= reach or high[2] - rise_at(outline, d) <= z[i]:
            continue
        v, r = touch_segment(outline, slope, length, px * ex + py * ey, d)
        if r <= outline.radius:
            z[i] = max(z[i], base + slope * v - rise_at(outline, r))
