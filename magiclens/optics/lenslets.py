"""Lenslets to second order: slopes, edge profiles and drifts of facet-patch transformations, before any is built."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.optics.refraction import facet_normal, refract


@njit(cache=True)
def _at(cx, cy, px, py, offset, m, eye, vertical, depth, gap, ior, out):
    """Unit normal (out[0:3]) and dh/du, dh/dv (out[3:5]) at (px, py) from a facet's centre."""
    x, y = cx + px, cy + py
    sx, sy = cx + offset[0] + m[0] * px + m[1] * py, cy + offset[1] + m[1] * px + m[2] * py
    nx, ny, nz = facet_normal(eye[0], eye[1], eye[2], x, y, depth, sx, sy, gap, ior)
    far = eye[2] - depth
    along = -nz if vertical else (nx * (x - eye[0]) + ny * (y - eye[1])) / far - nz
    out[0], out[1], out[2], out[3], out[4] = nx, ny, nz, nx / along, ny / along


@njit(cache=True)
def _lost(x, y, along_x, outward, normal, cut_eye, vertical, eyes, depth, ior):
    """Width of the strip that a wall takes from the eyes' pictures, mm per mm of step, on average over the eyes.

    The wall at (x, y) faces along x or y, ``outward`` = +-1, and the facet with this normal stands higher. Rays in the
    slab that drift outward meet the wall from within; an eye that looks inward past the wall sees it from without.
    """
    a = 0 if along_x else 1
    here = x if along_x else y
    lean = 0.0 if vertical else (here - cut_eye[a]) / (cut_eye[2] - depth)
    total = 0.0
    for v in range(len(eyes)):
        dx, dy, dz = x - eyes[v, 0], y - eyes[v, 1], depth - eyes[v, 2]
        q = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        t = refract(dx * q, dy * q, dz * q, normal[0], normal[1], normal[2], ior)
        within = -t[a] / t[2] - lean if t[2] < 0.0 else 0.0
        without = (here - eyes[v, a]) / (eyes[v, 2] - depth) - lean
        total += max(outward * within, 0.0) + max(-outward * without, 0.0)
    return total / len(eyes)


@njit(cache=True, parallel=True)
def edge_models(centres, offsets, maps, eye, eyes, vertical, pitch, depth, gap, ior, points):
    """Edge profiles, mm, of zero-mean lenslets, and outward drifts, both (F, K, 4, Q) float32.

    centres: (F, 2) mm. offsets: (F, K, 2) mm, maps: (F, K, 3), as in ``artifacts.Candidates``. Slopes are taken at the
    centre and the four edge midpoints of each facet, on the plane z = depth; the lenslet between is quadratic. Edges
    and drifts are those of ``optics.walls``; drifts are equal along an edge, means over the ``eyes`` (V, 3), and count
    walls seen askew.
    """
    facets, labels, _ = offsets.shape
    profiles = np.zeros((facets, labels, 4, points), np.float32)
    drifts = np.zeros((facets, labels, 4, points), np.float32)
    half = 0.5 * pitch
    for f in prange(facets):
        s = np.zeros((5, 5))
        cx, cy = centres[f, 0], centres[f, 1]
        for k in range(labels):
            for e in range(5):
                px = half if e == 0 else (-half if e == 2 else 0.0)
                py = half if e == 1 else (-half if e == 3 else 0.0)
                _at(cx, cy, px, py, offsets[f, k], maps[f, k], eye, vertical, depth, gap, ior, s[e])
            gu, gv = s[4, 3], s[4, 4]
            guu, gvv = (s[0, 3] - s[2, 3]) / pitch, (s[1, 4] - s[3, 4]) / pitch
            guv = 0.5 * ((s[1, 3] - s[3, 3]) + (s[0, 4] - s[2, 4])) / pitch
            mean = (guu + gvv) * pitch * pitch / 24.0
            for e in range(4):
                side, outward = e == 0 or e == 2, 1.0 if e < 2 else -1.0
                x, y = cx + (outward * half if side else 0.0), cy + (0.0 if side else outward * half)
                drifts[f, k, e, :] = _lost(x, y, side, outward, s[e], eye, vertical, eyes, depth, ior)
                for q in range(points):
                    along = ((q + 0.5) / points - 0.5) * pitch
                    u = half if e == 0 else (-half if e == 2 else along)
                    v = half if e == 1 else (-half if e == 3 else along)
                    rise = gu * u + gv * v + 0.5 * (guu * u * u + gvv * v * v) + guv * u * v
                    profiles[f, k, e, q] = rise - mean
    return profiles, drifts


@njit(cache=True, parallel=True)
def built_drifts(shapes, centres, eye, eyes, vertical, cell, depth, ior):
    """(F, 4, k) float32: drifts at the vertices of the edges of facets that have been built, as in ``optics.walls``.

    shapes: (F, k, k) heights of vertices, mm, ``cell`` mm apart. Drifts are means over the micro-facets at a vertex.
    """
    m = shapes.shape[1] - 1
    drifts = np.zeros((len(shapes), 4, m + 1), np.float32)
    half = 0.5 * m * cell
    for f in prange(len(shapes)):
        normal = np.zeros(3)
        for e in range(4):
            side, outward = e == 0 or e == 2, 1.0 if e < 2 else -1.0
            for q in range(m):
                i = q if side else (0 if e == 1 else m - 1)
                j = (m - 1 if e == 0 else 0) if side else q
                tl, tr, bl, br = shapes[f, i, j], shapes[f, i, j + 1], shapes[f, i + 1, j], shapes[f, i + 1, j + 1]
                gu, gv = ((tr - tl) / cell, (tr - br) / cell) if e < 2 else ((br - bl) / cell, (tl - bl) / cell)
                along = (q + 0.5) * cell - half
                x = centres[f, 0] + (outward * half if side else along)
                y = centres[f, 1] + (-along if side else outward * half)
                nz = 1.0 if vertical else 1.0 - (gu * (x - eye[0]) + gv * (y - eye[1])) / (eye[2] - depth)
                length = math.sqrt(gu * gu + gv * gv + nz * nz)
                normal[0], normal[1], normal[2] = -gu / length, -gv / length, nz / length
                drift = _lost(x, y, side, outward, normal, eye, vertical, eyes, depth, ior)
                low = m - 1 - q if side else q
                drifts[f, e, low] += drift if low == 0 else 0.5 * drift
                drifts[f, e, low + 1] += drift if low + 1 == m else 0.5 * drift
    return drifts


@njit(cache=True, parallel=True)
def centre_slopes(centres, offsets, maps, eye, depth, gap, ior):
    """(F, K, 2) dz/dx and dz/dy at the facets' centres that show the patches at ``offsets`` (F, K, 2) mm."""
    out = np.zeros(offsets.shape)
    for f in prange(len(offsets)):
        s = np.zeros(5)
        for k in range(offsets.shape[1]):
            _at(centres[f, 0], centres[f, 1], 0.0, 0.0, offsets[f, k], maps[f, k], eye, True, depth, gap, ior, s)
            out[f, k, 0], out[f, k, 1] = s[3], s[4]
    return out
