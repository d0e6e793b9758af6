"""Fewer triangles where the surface bends little, within a bound on its slope."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Lens, Solid
from magiclens.geometry.solid import facet_faces, grid_lines, top_faces


def decimated(solid: Solid, lens: Lens, tolerance_deg: float) -> Solid:
    """The solid with fewer triangles inside its facets.

    Nowhere on a facet do the normals of the new surface and of the old one differ by more than the tolerance, nor does
    a vertex that is left out lie farther from the new surface than the tolerance, in radians, times the width of a
    micro-facet. Borders of facets, walls, rim, sides and bottom stay as they are, and so do the vertices that are left.

    Args:
        solid: Closed, with the grid of the lens; one with another grid, or none, is returned as it is.
        lens: The lens that the solid was made for.
        tolerance_deg: Largest angle between old and new normals, degrees; 0 returns the solid as it is.
    """
    lines = len(grid_lines(lens))
    if tolerance_deg <= 0 or solid.grid != (lines, lines):
        return solid
    facets = _vertices_of_facets(lens)
    others = np.concatenate([top_faces(lines, lines)[~facet_faces(lens)], solid.faces[2 * (lines - 1) ** 2 :]])
    faces = np.concatenate([_fewer(solid.vertices[facets], lens, math.radians(tolerance_deg), facets), others])
    used, renamed = np.unique(faces, return_inverse=True)
    return Solid(solid.vertices[used], renamed.reshape(-1, 3).astype(np.int32), None, solid.eye_mm, solid.metrics)


def _vertices_of_facets(lens: Lens) -> IntArray:
    """(N * N, (m + 1)^2) indices of every facet's vertices in the top's grid, row by row."""
    n, k = lens.facets, lens.microfacets + 1
    lines = n * k + 2
    inner = np.arange(lines**2).reshape(lines, lines)[1:-1, 1:-1]
    return inner.reshape(n, k, n, k).transpose(0, 2, 1, 3).reshape(n * n, k * k)


def _fewer(points: FloatArray, lens: Lens, tolerance: float, names: IntArray) -> IntArray:
    """(F, 3) the triangles that are left of facets with these vertices (N * N, V, 3), by the vertices' ``names``."""
    from magiclens.geometry.decimation_kernels import decimate
    from magiclens.kernels.threads import in_threads

    micro_facet_mm = (lens.pitch_mm - lens.wall_mm) / lens.microfacets
    corners = np.tile(top_faces(lens.microfacets + 1, lens.microfacets + 1).astype(np.int32), (len(points), 1, 1))
    in_threads(decimate, len(points), points, corners, tolerance, micro_facet_mm)
    facet, left = np.nonzero(corners[..., 0] >= 0)
    found: IntArray = names[facet[:, None], corners[facet, left]]
    return found
