"""The built-in ray tracer: what each point of the lens's square shows to an eye, and how strongly.

One path per sample, followed from the eye: where light splits into a refracted and a reflected part, the stronger
one is followed and its share kept. Rays may leave through walls and enter again. The source is an emitter below the
flat bottom; whatever ends elsewhere is black.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.kernels.sampling import place
from magiclens.optics.refraction import refract, transmittance

MAX_EVENTS = 8
"""Refractions and reflections after which a path counts as lost."""
_SPLIT = 1e-12


@njit(cache=True)
def _to_grid(x, y, z, eye, plane, vertical):
    if vertical:
        return x, y, z
    w = plane / (eye[2] - z)
    return eye[0] + (x - eye[0]) * w, eye[1] + (y - eye[1]) * w, w


@njit(cache=True)
def _from_grid(u, v, w, eye, plane, vertical):
    if vertical:
        return u, v, w
    return eye[0] + (u - eye[0]) / w, eye[1] + (v - eye[1]) / w, eye[2] - plane / w


@njit(cache=True)
def _cell(lines, value, descending):
    """Index of the interval of ``lines`` that holds ``value``, clipped to the grid."""
    lo, hi = 0, len(lines) - 1
    while hi - lo > 1:
        mid = (lo + hi) // 2
        if (lines[mid] <= value) != descending:
            lo = mid
        else:
            hi = mid
    return lo


@njit(cache=True)
def _entry(us, vs, u0, v0, du, dv):
    """Fraction of a segment at which it enters the grid's rectangle; 0 from within, 2 if it never does."""
    first, last = 0.0, 1.0
    for low, high, start, run in ((us[0], us[-1], u0, du), (vs[-1], vs[0], v0, dv)):
        if run == 0.0:
            if start < low or start > high:
                return 2.0
            continue
        a, b = (low - start) / run, (high - start) / run
        first, last = max(first, min(a, b)), min(last, max(a, b))
    return first if first <= last else 2.0


@njit(cache=True)
def _facing(points, r, c, upper, out):
    """Upward unit normal, in space, of the upper-right (tl, br, tr) or lower-left (tl, bl, br) triangle of a cell."""
    a, d = points[r, c], points[r + 1, c + 1]
    b = points[r, c + 1] if upper else points[r + 1, c]
    px, py, pz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    qx, qy, qz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    sign = 1.0 if upper else -1.0
    q = sign / math.sqrt(nx * nx + ny * ny + nz * nz)
    out[0], out[1], out[2] = nx * q, ny * q, nz * q


@njit(cache=True)
def _march(us, vs, ws, u0, v0, w0, u1, v1, w1, r, c, skip, inside, found):
    """Follow the segment from (u0, v0, w0), in cell (r, c), to (u1, v1, w1) until it crosses the surface.

    skip: 1 or 2 leaves out the upper or lower triangle of the first cell, on which the segment starts; 0: none.
    Returns the fraction of the segment at the crossing, or 2 if there is none, or 3 if it leaves the grid;
    found = (row, column, 1 upper / 2 lower) of the crossed triangle.
    """
    du, dv, dw = u1 - u0, v1 - v0, w1 - w0
    side = 1.0 if inside else -1.0
    here = 0.0
    while True:
        wide, tall = us[c + 1] - us[c], vs[r] - vs[r + 1]
        out_u = ((us[c + 1] if du > 0 else us[c]) - u0) / du if du != 0.0 else 2.0
        out_v = ((vs[r] if dv > 0 else vs[r + 1]) - v0) / dv if dv != 0.0 else 2.0
        leave = min(out_u, out_v, 1.0)
        s0, ds = (u0 - us[c]) / wide, du / wide
        t0, dt = (vs[r] - v0) / tall, -dv / tall
        a, b, d, e = ws[r, c], ws[r, c + 1], ws[r + 1, c], ws[r + 1, c + 1]
        bend = (t0 - s0) / (ds - dt) if ds != dt else -1.0
        for piece in range(2):
            if piece == 0:
                start, end = here, bend if here < bend < leave else leave
            else:
                if not here < bend < leave:
                    break
                start, end = bend, leave
            middle = 0.5 * (start + end)
            upper = s0 + ds * middle > t0 + dt * middle
            if skip == (1 if upper else 2):
                continue
            if upper:
                f0, df = a + s0 * (b - a) + t0 * (e - b), ds * (b - a) + dt * (e - b)
            else:
                f0, df = a + t0 * (d - a) + s0 * (e - d), dt * (d - a) + ds * (e - d)
            f0, df = side * (w0 - f0), side * (dw - df)
            if f0 + df * end > _SPLIT and end > start:
                found[0], found[1], found[2] = r, c, 1 if upper else 2
                at = -f0 / df if df != 0.0 else start
                return min(max(at, start), end)
        skip = 0
        if leave >= 1.0:
            return 2.0
        here = leave
        if out_u <= out_v:
            c += 1 if du > 0 else -1
        else:
            r += -1 if dv > 0 else 1
        if c < 0 or r < 0 or c > len(us) - 2 or r > len(vs) - 2:
            return 3.0


@njit(cache=True)
def _to_source(x, y, z, dx, dy, dz, weight, gap, ior, out):
    """Through the flat bottom and the gap: source point and weight, or weight 0 on total internal reflection."""
    weight *= transmittance(-dz, 1.0 / ior)
    ox, oy, oz = refract(dx, dy, dz, 0.0, 0.0, 1.0, 1.0 / ior)
    if weight > 0.0 and oz < 0.0:
        out[0] = x - dx * z / dz - ox * gap / oz
        out[1] = y - dy * z / dz - oy * gap / oz
        out[2] = weight


@njit(cache=True)
def _follow(us, vs, ws, points, cut_eye, plane, vertical, top, floor, eye, qx, qy, qz, gap, ior, normal, found, out):
    """The path from the eye through (qx, qy, qz) on the reference plane; out = source x, y and transmission."""
    out[2] = 0.0
    dx, dy, dz = qx - eye[0], qy - eye[1], qz - eye[2]
    q = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * q, dy * q, dz * q
    rise = (top + 1e-3 - eye[2]) / dz
    x, y, z = eye[0] + dx * rise, eye[1] + dy * rise, top + 1e-3
    inside, weight, skip = False, 1.0, 0
    u0, v0, w0 = _to_grid(x, y, z, cut_eye, plane, vertical)
    u1, v1, w1 = _to_grid(x - dx * z / dz, y - dy * z / dz, 0.0, cut_eye, plane, vertical)
    at = _entry(us, vs, u0, v0, u1 - u0, v1 - v0)
    if at > 1.0:
        return
    u0, v0, w0 = u0 + at * (u1 - u0), v0 + at * (v1 - v0), w0 + at * (w1 - w0)
    x, y, z = _from_grid(u0, v0, w0, cut_eye, plane, vertical)
    r, c = _cell(vs, v0, True), _cell(us, u0, False)
    if w0 < max(ws[r, c], ws[r, c + 1], ws[r + 1, c], ws[r + 1, c + 1]) and at > 0.0:
        return  # it meets the slab's side
    for _ in range(MAX_EVENTS):
        if dz == 0.0:
            return
        reach = (top + 2e-3 - z) / dz if dz > 0.0 else -z / dz
        u1, v1, w1 = _to_grid(x + dx * reach, y + dy * reach, z + dz * reach, cut_eye, plane, vertical)
        at = _march(us, vs, ws, u0, v0, w0, u1, v1, w1, r, c, skip, inside, found)
        if at >= 2.0:
            lands = inside and dz < 0.0
            if lands and at == 3.0:  # beyond the last facet the slab goes on as far as its sides lean out
                fx, fy = x - dx * z / dz, y - dy * z / dz
                lands = floor[0] <= fx <= floor[1] and floor[2] <= fy <= floor[3]
            if lands:
                _to_source(x, y, z, dx, dy, dz, weight, gap, ior, out)
            return
        u0, v0, w0 = u0 + at * (u1 - u0), v0 + at * (v1 - v0), w0 + at * (w1 - w0)
        x, y, z = _from_grid(u0, v0, w0, cut_eye, plane, vertical)
        r, c, skip = found[0], found[1], found[2]
        _facing(points, r, c, skip == 1, normal)
        sign = -1.0 if inside else 1.0
        nx, ny, nz = sign * normal[0], sign * normal[1], sign * normal[2]
        eta = 1.0 / ior if inside else ior
        cos_i = -(dx * nx + dy * ny + dz * nz)
        share = transmittance(max(cos_i, 0.0), eta)
        if share >= 0.5:
            dx, dy, dz = refract(dx, dy, dz, nx, ny, nz, eta)
            inside = not inside
            weight *= share
        else:
            dx, dy, dz = dx + 2.0 * cos_i * nx, dy + 2.0 * cos_i * ny, dz + 2.0 * cos_i * nz
            weight *= 1.0 - share


@njit(cache=True, parallel=True)
def trace_rows(
    us, vs, ws, points, cut_eye, plane, vertical, top, floor, eye, size, depth, gap, ior,
    resolution, samples, first, end,
):  # fmt: skip
    hits = np.zeros((end - first, resolution, samples * samples, 3), np.float32)
    pixel = size / resolution
    for row in prange(end - first):
        i = first + np.int64(row)  # prange counts unsigned
        normal, out, found = np.zeros(3), np.zeros(3), np.zeros(3, np.int64)
        for j in range(resolution):
            for k in range(samples * samples):
                right, down = place(k, samples)
                qx, qy = (j + right) * pixel - 0.5 * size, 0.5 * size - (i + down) * pixel
                _follow(
                    us, vs, ws, points, cut_eye, plane, vertical, top, floor, eye, qx, qy, depth, gap, ior,
                    normal, found, out,
                )
                hits[row, j, k, 0], hits[row, j, k, 1], hits[row, j, k, 2] = out[0], out[1], out[2]
    return hits


@njit(cache=True, parallel=True)
def look_up(hits, source, per_mm):
    rows, columns, channels = source.shape
    height, width, samples, _ = hits.shape
    out = np.zeros((height, width, channels), np.float32)
    for i in prange(height):
        for j in range(width):
            for k in range(samples):
                weight = hits[i, j, k, 2] / samples
                if weight == 0.0:
                    continue
                x, y = hits[i, j, k, 0] * per_mm, -hits[i, j, k, 1] * per_mm
                if abs(x) > 0.5 * columns or abs(y) > 0.5 * rows:
                    continue
                x = min(max(x + 0.5 * columns - 0.5, 0.0), columns - 1.001)
                y = min(max(y + 0.5 * rows - 0.5, 0.0), rows - 1.001)
                ix, iy = int(x), int(y)
                fx, fy = x - ix, y - iy
                for ch in range(channels):
                    top = source[iy, ix, ch] * (1 - fx) + source[iy, ix + 1, ch] * fx
                    low = source[iy + 1, ix, ch] * (1 - fx) + source[iy + 1, ix + 1, ch] * fx
                    out[i, j, ch] += weight * (top * (1 - fy) + low * fy)
    return out
