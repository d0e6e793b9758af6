"""Lenslets to second order: slopes, edge profiles and drifts of facet-patch transformations, before any is built."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.optics.refraction import facet_normal, sine_in_slab


@njit(cache=True)
def _at(cx, cy, px, py, offset, m, eye, vertical, depth, gap, ior, out):
    """dh/du, dh/dv (out[0:2]) and drift from the wall (out[2:4], mm per mm down) at (px, py) from a facet's centre."""
    x, y = cx + px, cy + py
    sx, sy = cx + offset[0] + m[0] * px + m[1] * py, cy + offset[1] + m[1] * px + m[2] * py
    nx, ny, nz = facet_normal(eye[0], eye[1], eye[2], x, y, depth, sx, sy, gap, ior)
    far = eye[2] - depth
    lean_x, lean_y = (0.0, 0.0) if vertical else ((x - eye[0]) / far, (y - eye[1]) / far)
    along = nx * lean_x + ny * lean_y - nz
    out[0], out[1] = nx / along, ny / along
    rx, ry = sx - x, sy - y
    d = math.sqrt(rx * rx + ry * ry)
    s = sine_in_slab(d, depth, gap, ior)
    t = s / math.sqrt(1.0 - s * s) / d if d > 0.0 else 0.0
    # relative to the wall, which stands along the eye ray or upright
    out[2], out[3] = rx * t - lean_x, ry * t - lean_y


@njit(cache=True, parallel=True)
def edge_models(centres, offsets, maps, eye, vertical, pitch, depth, gap, ior, points):
    """Edge profiles (F, K, 4, Q) float32, mm, of zero-mean lenslets, and outward drifts (F, K, 4) float32.

    centres: (F, 2) mm. offsets: (F, K, 2) mm, maps: (F, K, 3), as in ``artifacts.Candidates``. Slopes are taken at the
    centre and the four edge midpoints of each facet, on the plane z = depth; the lenslet between is quadratic. Edges
    and drifts are those of ``optics.walls``.
    """
    facets, labels, _ = offsets.shape
    profiles = np.zeros((facets, labels, 4, points), np.float32)
    drifts = np.zeros((facets, labels, 4), np.float32)
    half = 0.5 * pitch
    for f in prange(facets):
        s = np.zeros((5, 4))
        cx, cy = centres[f, 0], centres[f, 1]
        for k in range(labels):
            for e in range(5):
                px = half if e == 0 else (-half if e == 2 else 0.0)
                py = half if e == 1 else (-half if e == 3 else 0.0)
                _at(cx, cy, px, py, offsets[f, k], maps[f, k], eye, vertical, depth, gap, ior, s[e])
            gu, gv = s[4, 0], s[4, 1]
            guu, gvv = (s[0, 0] - s[2, 0]) / pitch, (s[1, 1] - s[3, 1]) / pitch
            guv = 0.5 * ((s[1, 0] - s[3, 0]) + (s[0, 1] - s[2, 1])) / pitch
            mean = (guu + gvv) * pitch * pitch / 24.0
            for e in range(4):
                out = s[e, 2] if e == 0 or e == 2 else s[e, 3]
                drifts[f, k, e] = max(out if e < 2 else -out, 0.0)
                for q in range(points):
                    along = ((q + 0.5) / points - 0.5) * pitch
                    u = half if e == 0 else (-half if e == 2 else along)
                    v = half if e == 1 else (-half if e == 3 else along)
                    rise = gu * u + gv * v + 0.5 * (guu * u * u + gvv * v * v) + guv * u * v
                    profiles[f, k, e, q] = rise - mean
    return profiles, drifts


@njit(cache=True, parallel=True)
def centre_slopes(centres, offsets, maps, eye, depth, gap, ior):
    """(F, K, 2) dz/dx and dz/dy at the facets' centres that show the patches at ``offsets`` (F, K, 2) mm."""
    out = np.zeros(offsets.shape)
    for f in prange(len(offsets)):
        s = np.zeros(4)
        for k in range(offsets.shape[1]):
            _at(centres[f, 0], centres[f, 1], 0.0, 0.0, offsets[f, k], maps[f, k], eye, True, depth, gap, ior, s)
            out[f, k, 0], out[f, k, 1] = s[0], s[1]
    return out
