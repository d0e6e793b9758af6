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
from magiclens.optics.refraction import facet_normal


@njit(cache=True)
def _slope(u, v, h, cx, cy, offset, m, eye, cut_eye, vertical, depth, gap, ior, cos_limit):
    """dh/du and dh/dv at (u, v), and whether the slope limit was hit."""
    x, y, z = u, v, depth + h
    if not vertical:
        far = cut_eye[2] - depth
        rho = math.exp(-h / far)
        x, y = cut_eye[0] + rho * (u - cut_eye[0]), cut_eye[1] + rho * (v - cut_eye[1])
        z = cut_eye[2] - rho * far
    # the eye sees the surface point where its ray crosses the reference plane: that is the point of the tile
    t = (eye[2] - depth) / (eye[2] - z)
    px, py = eye[0] + (x - eye[0]) * t - cx, eye[1] + (y - eye[1]) * t - cy
    sx, sy = cx + offset[0] + m[0] * px + m[1] * py, cy + offset[1] + m[1] * px + m[2] * py
    nx, ny, nz = facet_normal(eye[0], eye[1], eye[2], x, y, z, sx, sy, gap, ior)
    clamped = nz < cos_limit
    if clamped:
        side = math.sqrt((1.0 - cos_limit * cos_limit) / max(nx * nx + ny * ny, 1e-30))
        nx, ny, nz = nx * side, ny * side, cos_limit
    if vertical:
        return -nx / nz, -ny / nz, clamped
    nd = (nx * (u - cut_eye[0]) + ny * (v - cut_eye[1])) / far - nz
    return nx / nd, ny / nd, clamped


@njit(cache=True, parallel=True)
def _edge_rises(heights, centres, pitch, wall, offsets, maps, eye, cut_eye, vertical, depth, gap, ior, cos_limit):
    facets, k = heights.shape[0], heights.shape[1]
    m = k - 1
    along_u = np.zeros((facets, k, m))
    along_v = np.zeros((facets, m, k))
    clamped = np.zeros(facets, np.int64)
    side = pitch - wall
    d = side / m
    for f in prange(facets):
        cx, cy = centres[f, 0], centres[f, 1]
        for a in range(k):
            for b in range(k):
                u, v = cx - 0.5 * side + b * d, cy + 0.5 * side - a * d
                if b < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a, b + 1])
                    g, _, bad = _slope(
                        u + 0.5 * d, v, h, cx, cy, offsets[f], maps[f],
                        eye, cut_eye, vertical, depth, gap, ior, cos_limit,
                    )
                    along_u[f, a, b] = g * d
                    clamped[f] += bad
                if a < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a + 1, b])
                    _, g, bad = _slope(
                        u, v - 0.5 * d, h, cx, cy, offsets[f], maps[f],
                        eye, cut_eye, vertical, depth, gap, ior, cos_limit,
                    )
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
    eye = scene.reference_eye_mm
    rows, columns, clamped = _edge_rises(
        heights.reshape(n * n, *heights.shape[2:]),
        lens.facet_centres_mm().reshape(-1, 2), lens.pitch_mm, lens.wall_mm,
        assignment.offsets_mm.reshape(-1, 2).astype(np.float64), assignment.maps.reshape(-1, 3).astype(np.float64),
        eye, eye, lens.cells == "vertical", lens.thickness_mm, lens.gap_mm, lens.ior,
        math.cos(math.radians(lens.max_slope_deg)),
    )
    return rows, columns, clamped
