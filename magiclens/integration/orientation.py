"""The slopes that facets need, given where the surface is now (4.3).

A vertex at (u, v) with height h lies at ``X = eye + exp(-h / D) * d``, d = (u, v, thickness) - eye. From N . X_u = 0
follows ``dh/du = D * N_x / (N . d)``, and the same for v: exact, and linear in h. Vertical cells are the limit of an
infinitely distant eye: ``dh/du = -N_x / N_z``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import Assignment, FloatArray, Scene
from magiclens.optics.eyes import height_gradient, project, surface_point
from magiclens.optics.medium import cut_of, optics_of
from magiclens.optics.refraction import facet_normal


@njit(cache=True)
def _slope(u, v, h, centre, offset, m, optics):
    """dh/du and dh/dv at (u, v), and whether the slope limit was hit."""
    point = surface_point(optics, u, v, h, optics.depth)
    # the eye sees the surface point where its ray crosses the reference plane: that is the point of the tile
    x, y = project(optics.eye, point, optics.depth)
    px, py = x - centre[0], y - centre[1]
    sx = centre[0] + offset[0] + m[0] * px + m[1] * py
    sy = centre[1] + offset[1] + m[1] * px + m[2] * py
    nx, ny, nz = facet_normal(optics.eye, point, (sx, sy), optics)
    cos_limit = optics.cos_limit
    clamped = nz < cos_limit
    if clamped:
        side = math.sqrt((1.0 - cos_limit * cos_limit) / max(nx * nx + ny * ny, 1e-30))
        nx, ny, nz = nx * side, ny * side, cos_limit
    gu, gv = height_gradient(optics, u, v, (nx, ny, nz), optics.depth)
    return gu, gv, clamped


@njit(cache=True, parallel=True)
def _edge_rises(heights, centres, offsets, maps, side, optics):
    """See ``edge_rises``; F facets, ``side`` mm from a facet's first vertex to its last."""
    facets, k = heights.shape[0], heights.shape[1]
    m = k - 1
    along_u = np.zeros((facets, k, m))
    along_v = np.zeros((facets, m, k))
    clamped = np.zeros(facets, np.int64)
    d = side / m
    for f in prange(facets):
        centre = centres[f]
        for a in range(k):
            for b in range(k):
                u, v = centre[0] - 0.5 * side + b * d, centre[1] + 0.5 * side - a * d
                if b < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a, b + 1])
                    g, _, bad = _slope(u + 0.5 * d, v, h, centre, offsets[f], maps[f], optics)
                    along_u[f, a, b] = g * d
                    clamped[f] += bad
                if a < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a + 1, b])
                    _, g, bad = _slope(u, v - 0.5 * d, h, centre, offsets[f], maps[f], optics)
                    along_v[f, a, b] = -g * d
                    clamped[f] += bad
    return along_u, along_v, clamped


def edge_rises(scene: Scene, assignment: Assignment, heights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The rise of h along every mesh edge that shows each point of each tile its source point.

    heights: (N, N, m + 1, m + 1) mm. Returns the rises along rows, (F, m + 1, m), from column b to b + 1, and along
    columns, (F, m, m + 1), from row a to a + 1 (F = N * N), mm; and how many edges of each facet (F,) were held at
    the slope limit. Each of a cell's two triangles contains one edge of either kind, so these are its exact slopes.
    """
    lens, n = scene.lens, scene.lens.facets
    rows, columns, clamped = _edge_rises(
        heights.reshape(n * n, *heights.shape[2:]), lens.facet_centres_mm().reshape(-1, 2),
        assignment.offsets_mm.reshape(-1, 2).astype(np.float64), assignment.maps.reshape(-1, 3).astype(np.float64),
        lens.pitch_mm - lens.wall_mm, optics_of(lens, cut_of(scene)),
    )  # fmt: skip
    return rows, columns, clamped
