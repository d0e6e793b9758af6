"""What other eyes see through a facet that was designed for one: position and local map, by exact refraction (4.6).

A lenslet is given by the patch that the *reference eye* shall see: ``s(q) = c + R + M (q - c)`` where its ray crosses
the reference plane at q, for the facet centred at c. That fixes the normal at every point, and with it what every other
eye sees. Points are named by q, whether the cells stand along this eye's rays or upright. Horizontal axes may be
mirrored (images run y down): Snell's law does not mind.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from magiclens.optics.refraction import facet_normal, refract

STEP_MM = 0.02
"""Of the finite differences."""

LANDING, MAP, SPAN, PLACE, SHEAR, FLAT, SIGHT = 0, 2, 6, 10, 12, 16, 20
"""Where in a sight: landing point (2), its derivative along the facet (2 x 2, row-major) and along the reference eye's
source point (2 x 2), the facet's place in the picture (2), its derivative (2 x 2), the derivative of the landing point
along a flat facet (2 x 2); and the length of it all."""


@njit(cache=True)
def lift(eye, x, y, height, depth):
    """The surface point at ``height`` over (x, y) of the reference plane, along the eye's ray."""
    far = eye[2] - depth
    rho = math.exp(-height / far)
    return eye[0] + rho * (x - eye[0]), eye[1] + rho * (y - eye[1]), eye[2] - rho * far


@njit(cache=True)
def slopes(eye, x, y, nx, ny, nz, depth):
    """dh/dx and dh/dy over the reference plane of a surface with unit normal n (see ``HeightField``)."""
    along = (nx * (x - eye[0]) + ny * (y - eye[1])) / (eye[2] - depth) - nz
    return nx / along, ny / along


@njit(cache=True)
def land(eye, x, y, z, nx, ny, nz, gap, ior):
    """Where the eye's ray through the surface point with this normal meets the source, and whether it does."""
    dx, dy, dz = x - eye[0], y - eye[1], z - eye[2]
    q = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * q, dy * q, dz * q
    if dx * nx + dy * ny + dz * nz >= 0.0:
        return 0.0, 0.0, False
    tx, ty, tz = refract(dx, dy, dz, nx, ny, nz, ior)
    out = 1.0 - ior * ior * (1.0 - tz * tz)
    if tz >= 0.0 or out <= 0.0:
        return 0.0, 0.0, False
    reach = gap * ior / math.sqrt(out) - z / tz
    return x + tx * reach, y + ty * reach, True


@njit(cache=True)
def _seen(eye, cut_eye, x, y, height, sx, sy, depth, gap, ior):
    """Landing point of the eye's ray where the facet shows (sx, sy) to the reference eye, and the normal there."""
    px, py, pz = lift(cut_eye, x, y, height, depth)
    nx, ny, nz = facet_normal(cut_eye[0], cut_eye[1], cut_eye[2], px, py, pz, sx, sy, gap, ior)
    lx, ly, ok = land(eye, px, py, pz, nx, ny, nz, gap, ior)
    return lx, ly, nx, ny, nz, ok


@njit(cache=True)
def _place(eye, cut_eye, x, y, height, depth):
    """Where on the reference plane the eye sees the surface point over (x, y)."""
    px, py, pz = lift(cut_eye, x, y, height, depth)
    t = (eye[2] - depth) / (eye[2] - pz)
    return eye[0] + (px - eye[0]) * t, eye[1] + (py - eye[1]) * t


@njit(cache=True)
def sight(eye, cut_eye, cx, cy, height, rx, ry, depth, gap, ior, whole, out):
    """Fill ``out`` (SIGHT,) for the facet at (cx, cy), mm, that shows the patch at offset (rx, ry) to the cutting eye.

    height: of the facet's centre above the reference plane. whole: False leaves out PLACE, SHEAR and FLAT. Of a lenslet
    with map M, a point p from the centre shows this eye ``LANDING + (MAP + SPAN M) p`` at ``PLACE + SHEAR p``; within a
    flat micro-facet the source passes by at FLAT. Returns False where the light is reflected totally.
    """
    sx, sy = cx + rx, cy + ry
    lx, ly, nx, ny, nz, ok = _seen(eye, cut_eye, cx, cy, height, sx, sy, depth, gap, ior)
    if not ok:
        return False
    gx, gy = slopes(cut_eye, cx, cy, nx, ny, nz, depth)
    out[LANDING], out[LANDING + 1] = lx, ly
    px, py = 0.0, 0.0
    if whole:
        px, py = _place(eye, cut_eye, cx, cy, height, depth)
        out[PLACE], out[PLACE + 1] = px, py
    for axis in range(2):
        dx, dy = (STEP_MM, 0.0) if axis == 0 else (0.0, STEP_MM)
        h = height + gx * dx + gy * dy
        ax, ay, _, _, _, good = _seen(eye, cut_eye, cx + dx, cy + dy, h, sx, sy, depth, gap, ior)
        bx, by, _, _, _, fine = _seen(eye, cut_eye, cx, cy, height, sx + dx, sy + dy, depth, gap, ior)
        if not (good and fine):
            return False
        out[MAP + axis], out[MAP + 2 + axis] = (ax - lx) / STEP_MM, (ay - ly) / STEP_MM
        out[SPAN + axis], out[SPAN + 2 + axis] = (bx - lx) / STEP_MM, (by - ly) / STEP_MM
        if whole:
            ux, uy = _place(eye, cut_eye, cx + dx, cy + dy, h, depth)
            out[SHEAR + axis], out[SHEAR + 2 + axis] = (ux - px) / STEP_MM, (uy - py) / STEP_MM
            qx, qy, qz = lift(cut_eye, cx + dx, cy + dy, h, depth)
            fx, fy, flat = land(eye, qx, qy, qz, nx, ny, nz, gap, ior)
            if not flat:
                return False
            out[FLAT + axis], out[FLAT + 2 + axis] = (fx - lx) / STEP_MM, (fy - ly) / STEP_MM
    return True


@njit(cache=True)
def local_map(seen, m, out):
    """out (4,) = MAP + SPAN M, row-major, for a symmetric M = (xx, xy, yy)."""
    for row in range(2):
        a, b = seen[SPAN + 2 * row], seen[SPAN + 2 * row + 1]
        out[2 * row] = seen[MAP + 2 * row] + a * m[0] + b * m[1]
        out[2 * row + 1] = seen[MAP + 2 * row + 1] + a * m[1] + b * m[2]


@njit(cache=True)
def sights(eye, cut_eye, centres, heights, offsets, depth, gap, ior):
    """(F, SIGHT) float64, one per facet, nan where light is reflected totally; see ``sight``.

    centres, offsets: (F, 2) mm. heights: (F,) mm.
    """
    out = np.full((len(centres), SIGHT), np.nan)
    row = np.zeros(SIGHT)
    for f in range(len(centres)):
        ok = sight(
            eye, cut_eye, centres[f, 0], centres[f, 1], heights[f], offsets[f, 0], offsets[f, 1],
            depth, gap, ior, True, row,
        )
        if ok:
            out[f] = row
    return out
