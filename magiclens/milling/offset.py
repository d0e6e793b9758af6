"""The offset surface: where a cutter's tip may go without cutting into a solid.

It is the grey-scale dilation of the solid's surface by the cutter's shape,
tip(p) = max over surface points q of z(q) - rise(|p - q|). It is taken over the triangles themselves, not over a raster
of them, so that nothing falls between samples: a face touches the cutter at one distance from its axis, where the
cutter is as steep as the face; what remains is touched at edges that are not valleys. Undercuts need no care, since the
highest surface wins.
"""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Solid
from magiclens.milling.border import Rectangle
from magiclens.milling.offset_kernels import (
    DepthMap,
    OffsetFaces,
    TipRaster,
    TouchableEdges,
    fill_depths,
    lowest_tips,
    shortened,
    touches,
)
from magiclens.milling.outline import Outline
from magiclens.milling.row_index import index_rows

_UPRIGHT = 1e-9
"""Faces whose unit normal has a smaller z are walls: only their edges can be touched from above."""
_VALLEY_MM = 1e-9
"""An edge counts as a valley if the far corner of one of its faces is higher than this above the other's plane."""


class Contacts:
    """The parts of a solid that a cutter can touch from above."""

    def __init__(self, solid: Solid, outline: Outline, covered: Rectangle | None = None):
        """Collect them.

        Args:
            solid: in the lens frame, mm.
            outline: the cutter's.
            covered: a rectangle without a hole in the solid. There the cutter cannot get so deep that it touches what
                is far away, which saves most of the work.
        """
        vertices = np.ascontiguousarray(solid.vertices, np.float64)
        faces = _facing_up(vertices, solid.faces)
        self._outline = outline
        self._faces = _offset_faces(vertices, faces, outline)
        self._edges = _edges(vertices, _ridges(vertices, faces), outline.radius)
        if covered:
            self._edges = _shortened(self._edges, vertices, faces, outline, covered)

    def tips(self, x_mm: FloatArray, y_mm: FloatArray, floor_mm: float) -> FloatArray:
        """The lowest z of the cutter's tip at every (x_mm[column], y_mm[row]).

        Args:
            x_mm: (columns,) ascending, evenly spaced, lens frame.
            y_mm: (rows,) ascending.
            floor_mm: the lowest z of all, which counts where there is no surface.

        Returns:
            (rows, columns) float64, mm, lens frame.
        """
        y_of_faces = self._faces.corners[:, :, 1]
        face_rows = index_rows(y_of_faces.min(axis=1), y_of_faces.max(axis=1), y_mm, y_mm)
        ends, reach = np.stack([self._edges.low[:, 1], self._edges.high[:, 1]], axis=1), self._edges.reach
        edge_rows = index_rows(ends.min(axis=1) - reach, ends.max(axis=1) + reach, y_mm, y_mm)
        step = (x_mm[-1] - x_mm[0]) / (len(x_mm) - 1) if len(x_mm) > 1 else 1.0
        raster = TipRaster(float(x_mm[0]), float(step), len(x_mm), np.ascontiguousarray(y_mm, np.float64))
        z: FloatArray = lowest_tips(
            self._outline, self._faces, face_rows, self._edges, edge_rows, raster, float(floor_mm)
        )
        return z


def _facing_up(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Faces that can be seen from above, walls left out."""
    normal = _normals(vertices, faces)
    up: IntArray = faces[normal[:, 2] > _UPRIGHT * np.linalg.norm(normal, axis=1)]
    return up


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(F, 3) outward normals, as long as twice the area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals: FloatArray = np.cross(b - a, c - a)
    return normals


def _offset_faces(vertices: FloatArray, faces: IntArray, outline: Outline) -> OffsetFaces:
    """Every face moved uphill by the distance from the axis at which it is touched, and down by the rise there."""
    normal = _normals(vertices, faces)
    slope = -normal[:, :2] / normal[:, 2:]
    steepness = np.linalg.norm(slope, axis=1)
    way, rise = touches(outline, steepness)
    shift = slope * (way / np.maximum(steepness, 1e-300))[:, None]  # level faces have way 0, and must not divide by 0
    corners = vertices[faces][:, :, :2] - shift[:, None]
    return OffsetFaces(np.ascontiguousarray(corners), vertices[faces[:, 0], 2] - rise, slope)


def _ridges(vertices: FloatArray, faces: IntArray) -> IntArray:
    """Edges of the faces, but for those that lie between two of them as the bottom of a valley.

    Args:
        vertices: (V, 3) mm.
        faces: (F, 3) faces that can be seen from above.

    Returns:
        (E, 2) indices of the edges' ends.
    """
    start, end, far = faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel(), faces[:, [2, 0, 1]].T.ravel()
    owner = np.tile(np.arange(len(faces)), 3)
    low, high = np.minimum(start, end), np.maximum(start, end)
    # sorted, the two faces that share an edge follow each other
    order = np.lexsort((high, low))
    low, high, far, owner = low[order], high[order], far[order], owner[order]
    first = np.flatnonzero(np.r_[True, (np.diff(low) != 0) | (np.diff(high) != 0)])
    count = np.diff(np.r_[first, len(low)])
    pair = first[count == 2]
    normal = _normals(vertices, faces[owner[pair]])
    above = vertices[far[pair + 1]] - vertices[faces[owner[pair], 0]]
    rise = np.einsum("ij,ij->i", normal, above) / np.linalg.norm(normal, axis=1)
    valley = np.zeros(len(low), bool)
    valley[pair[rise > _VALLEY_MM]] = True
    kept = first[~valley[first]]
    return np.column_stack([low[kept], high[kept]])


def _edges(vertices: FloatArray, ridges: IntArray, reach_mm: float) -> TouchableEdges:
    """The edges, each from its lower to its upper end, all with the same reach."""
    ends = vertices[ridges]
    falling = ends[:, 0, 2] > ends[:, 1, 2]
    ends[falling] = ends[falling][:, ::-1]
    low, high = (np.ascontiguousarray(ends[:, k]) for k in (0, 1))
    return TouchableEdges(low, high, np.full(len(ends), reach_mm))


def _shortened(
    edges: TouchableEdges, vertices: FloatArray, faces: IntArray, outline: Outline, covered: Rectangle
) -> TouchableEdges:
    """The edges with shorter reaches: the tip must be above the surface near an edge while they touch."""
    low, high = np.array([covered.x0, covered.y0]), np.array([covered.x1, covered.y1])
    side = max(outline.radius / 8, 0.1)
    count = np.maximum(((high - low) / side).astype(int) + 1, 1)
    depths = DepthMap(np.full(count, np.inf), low, high, side)
    fill_depths(vertices, faces, depths)
    for _ in range(2):  # a shorter reach sees less depth, and so becomes shorter again
        edges = edges._replace(reach=shortened(outline, edges, depths))
    return edges
