"""The triangles of an exported top: their facets, their slopes, and what an eye sees of them.

Triangles are traced without the tracer and its grid, so that the check is independent. Every triangle is represented
by its middle, and triangles do not hide each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Lens, View
from magiclens.preflight.mesh_file import MeshFile

if TYPE_CHECKING:
    from magiclens.preflight.triangles_kernels import TracedTriangles


@dataclass(frozen=True)
class TopTriangles:
    """The triangles of the top, lens frame.

    Attributes:
        triangles: (F, 3, 3) corners, mm.
        facet: (F,) the facet that each triangle lies in, row * N + column.
        wall: (F,) whether a triangle belongs to no facet, but to a wall or the rim.
        slope_deg: (F,) angle between +z and the outward normal.
    """

    triangles: FloatArray
    facet: IntArray
    wall: BoolArray
    slope_deg: FloatArray


def top_triangles(file: MeshFile, lens: Lens, eye_mm: FloatArray | None) -> TopTriangles:
    """The triangles of a file that belong to the top.

    Args:
        file: The mesh file.
        lens: The lens that it should hold.
        eye_mm: (3,) eye along whose rays the facets are cut, lens frame; None for vertical cells.
    """
    triangles = file.triangles[file.on_top]
    facet, wall = facets_of_triangles(triangles, lens, eye_mm)
    return TopTriangles(triangles, facet, wall, triangle_slopes_deg(triangles))


def trace_triangles(triangles: FloatArray, lens: Lens, eye_mm: FloatArray) -> TracedTriangles:
    """What an eye (3,) sees of triangles (F, 3, 3) of the top; lens frame, mm."""
    from magiclens.preflight.triangles_kernels import trace_middles

    traced: TracedTriangles = trace_middles(
        triangles, np.asarray(eye_mm, float), lens.thickness_mm, lens.gap_mm, lens.ior
    )
    return traced


def trace_triangles_for_views(triangles: FloatArray, lens: Lens, views: Sequence[View]) -> list[TracedTriangles]:
    """What the eye of each view, in the lens frame, sees of triangles (F, 3, 3); equal eyes are traced once."""
    traced: dict[bytes, TracedTriangles] = {}
    for view in views:
        if view.eye_mm.tobytes() not in traced:
            traced[view.eye_mm.tobytes()] = trace_triangles(triangles, lens, view.eye_mm)
    return [traced[view.eye_mm.tobytes()] for view in views]


def angles_deg(traced: TracedTriangles) -> FloatArray:
    """(F,) angles between the triangles' normals and the eye's rays."""
    return np.degrees(np.arccos(np.clip(traced.cosine, -1, 1)))


def triangle_slopes_deg(triangles: FloatArray) -> FloatArray:
    """(F,) angles between +z and the outward normals of triangles (F, 3, 3); above 90 a triangle faces down."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross((b - a).astype(np.float64), (c - a).astype(np.float64))
    return np.asarray(np.degrees(np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), normal[:, 2])))


def facets_of_triangles(triangles: FloatArray, lens: Lens, eye_mm: FloatArray | None) -> tuple[IntArray, BoolArray]:
    """The facet that each triangle lies in.

    Args:
        triangles: (F, 3, 3) corners, lens frame, mm.
        lens: The lens.
        eye_mm: (3,) eye along whose rays the facets are cut; None for vertical cells.

    Returns:
        (F,) row * N + column of the facet, and (F,) whether the triangle belongs to a wall or to the rim instead.
    """
    middle = triangles.mean(axis=1, dtype=np.float64)
    if eye_mm is not None:
        # along the eye's ray to the reference plane, on which the borders of cells are straight
        away = (eye_mm[2] - lens.thickness_mm) / (eye_mm[2] - middle[:, 2])
        middle = eye_mm + (middle - eye_mm) * away[:, None]
    cells = np.stack([lens.size_mm / 2 - middle[:, 1], middle[:, 0] + lens.size_mm / 2]) / lens.pitch_mm
    index = np.clip(cells.astype(int), 0, lens.facets - 1)
    border = 0.51 * lens.wall_mm / lens.pitch_mm  # half a wall's width, and a little for rounding in the file
    off = (np.minimum(cells - index, index + 1 - cells) < border).any(axis=0)
    return index[0] * lens.facets + index[1], off
