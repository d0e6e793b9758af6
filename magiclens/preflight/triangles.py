"""The triangles of an exported top: their facets, their slopes, and what an eye sees of them.

Triangles are traced without the tracer and its grid, so that the check is independent. Every triangle is represented
by its middle, and triangles do not hide each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Lens

if TYPE_CHECKING:
    from magiclens.preflight.triangles_kernels import TracedTriangles


class TopTriangles(NamedTuple):
    """What is known of the triangles of the top, in few bytes each: there may be many millions of them.

    Args:
        facet: (F,) int32, the facet that each triangle lies in, row * N + column.
        wall: (F,) whether a triangle belongs to no facet, but to a wall or the rim.
        slope_deg: (F,) float32, angle between +z and the outward normal.
        lowest_mm: (F,) float32, z of the lowest corner.
    """

    facet: IntArray
    wall: BoolArray
    slope_deg: FloatArray
    lowest_mm: FloatArray


def top_triangles(triangles: FloatArray, lens: Lens, eye_mm: FloatArray | None) -> TopTriangles:
    """What is known of triangles of the top.

    Args:
        triangles: (F, 3, 3) corners, lens frame, mm.
        lens: The lens that they should belong to.
        eye_mm: (3,) eye along whose rays the facets are cut, lens frame; None for vertical cells.
    """
    a, b, c = np.ascontiguousarray(triangles.transpose(1, 2, 0), np.float64)  # (3, F) each: numpy is fast along rows
    facet, wall = _facets_at((a + b + c) / 3, lens, eye_mm)
    lowest = np.minimum(np.minimum(a[2], b[2]), c[2])
    return TopTriangles(facet, wall, _slopes_deg(b - a, c - a).astype(np.float32), lowest.astype(np.float32))


def trace_triangles(triangles: FloatArray, lens: Lens, eye_mm: FloatArray) -> TracedTriangles:
    """What an eye (3,) sees of triangles (F, 3, 3) of the top; lens frame, mm."""
    from magiclens.preflight.triangles_kernels import trace_middles

    traced: TracedTriangles = trace_middles(
        triangles, np.asarray(eye_mm, float), lens.thickness_mm, lens.gap_mm, lens.ior
    )
    return traced


def _slopes_deg(p: FloatArray, q: FloatArray) -> FloatArray:
    """(F,) angles between +z and the outward normals of triangles with edges (3, F); above 90 one faces down."""
    x, y, z = p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]
    return np.asarray(np.degrees(np.arctan2(np.hypot(x, y), z)))


def _facets_at(middle: FloatArray, lens: Lens, eye_mm: FloatArray | None) -> tuple[IntArray, BoolArray]:
    """The facet that each triangle lies in.

    Args:
        middle: (3, F) middles of the triangles, lens frame, mm.
        lens: The lens.
        eye_mm: (3,) eye along whose rays the facets are cut; None for vertical cells.

    Returns:
        (F,) int32 row * N + column of the facet, and (F,) whether the triangle belongs to a wall or to the rim instead.
    """
    x, y, z = middle
    if eye_mm is not None:
        # along the eye's ray to the reference plane, on which the borders of cells are straight
        away = (eye_mm[2] - lens.thickness_mm) / (eye_mm[2] - z)
        x, y = eye_mm[0] + (x - eye_mm[0]) * away, eye_mm[1] + (y - eye_mm[1]) * away
    cells = np.stack([lens.size_mm / 2 - y, x + lens.size_mm / 2]) / lens.pitch_mm
    index = np.clip(cells.astype(np.int32), 0, lens.facets - 1)
    border = 0.51 * lens.wall_mm / lens.pitch_mm  # half a wall's width, and a little for rounding in the file
    off = np.minimum(cells - index, index + 1 - cells) < border
    return index[0] * lens.facets + index[1], off[0] | off[1]
