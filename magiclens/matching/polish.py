"""Continuous polishing of candidates: the offset and the symmetric map, by Levenberg-Marquardt.

The search tries offsets and maps on a lattice; a patch that almost fits is then moved, scaled and sheared until its
edges fall on the tile's edges. The map stays symmetric, so that a smooth lenslet can still realise it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import FloatArray
from magiclens.images import to_display
from magiclens.matching.search import distance_term, reachable

PARAMETERS = 5
"""Offset x, y and map xx, xy, yy."""


def blur_levels(source: FloatArray, source_px_mm: float, grain_mm: float, widths_mm: tuple[float, ...]) -> FloatArray:
    """(L, C, H, W) float32 display values: the source (C, H, W, linear light) averaged over boxes of these widths.

    A flat micro-facet shows a patch of its own size, ``grain_mm``, unmagnified: every level is averaged over that too.
    """
    grain = grain_mm / source_px_mm
    grained = box_blur(source, grain, grain)
    widths = [w / source_px_mm for w in widths_mm]
    return np.stack([to_display(box_blur(grained, w, w)) for w in widths]).astype(np.float32)


def box_blur(image: FloatArray, rows: float, columns: float) -> FloatArray:
    """Average of (C, H, W) over centred boxes of so many pixels, which need not be whole numbers."""
    from scipy.ndimage import convolve1d

    out = image
    for axis, width in ((1, rows), (2, columns)):
        if width > 1.0:
            whole = int((width - 1) / 2)
            rest = (width - 1) / 2 - whole
            kernel = np.concatenate([[rest], np.ones(2 * whole + 1), [rest]]) / width
            out = convolve1d(out, kernel, axis=axis, mode="nearest")
    return out


@njit(cache=True, fastmath=True)
def sample(image, x, y):
    """Bilinear value and its derivatives per pixel at column x and row y."""
    h, w = image.shape
    x = min(max(x, 0.0), w - 1.001)
    y = min(max(y, 0.0), h - 1.001)
    ix, iy = int(x), int(y)
    fx, fy = np.float32(x - ix), np.float32(y - iy)
    a, b = image[iy, ix], image[iy, ix + 1]
    c, d = image[iy + 1, ix], image[iy + 1, ix + 1]
    top, low = a + (b - a) * fx, c + (d - c) * fx
    return top + (low - top) * fy, (b - a) * (1 - fy) + (d - c) * fy, low - top


@njit(cache=True, fastmath=True)
def _normal_equations(tile, levels, widths, per_mm, cx, cy, px, p, jtj, jtr):
    """Mean squared difference of parameters p; fills J^T J (its lower half) and J^T r of the residuals.

    A residual's derivatives are the source's slopes (gx, gy), times u and v for the map: sums over gx^2, gx gy, gy^2
    and gx r, gy r, weighted by powers of u along a row, have all of them.
    """
    pixels, _, channels = tile.shape
    seen = px * math.sqrt(abs(p[2] * p[4] - p[3] * p[3]))
    level = 0
    while level + 1 < len(widths) and widths[level + 1] < 1.4 * seen:
        level += 1
    image = levels[level]
    rows, columns = image.shape[0], image.shape[1]
    half_w, half_h = 0.5 * columns - 0.5, 0.5 * rows - 0.5
    jtj[:], jtr[:], total = 0.0, 0.0, 0.0
    for ky in range(pixels):
        v = (ky - 0.5 * (pixels - 1)) * px
        xx0 = xx1 = xx2 = xy0 = xy1 = xy2 = yy0 = yy1 = yy2 = xr0 = xr1 = yr0 = yr1 = np.float32(0.0)
        for kx in range(pixels):
            u = (kx - 0.5 * (pixels - 1)) * px
            x = min(max((cx + p[0] + p[2] * u + p[3] * v) * per_mm + half_w, 0.0), columns - 1.001)
            y = min(max((cy + p[1] + p[3] * u + p[4] * v) * per_mm + half_h, 0.0), rows - 1.001)
            i, j = int(y), int(x)
            fx, fy, u = np.float32(x - j), np.float32(y - i), np.float32(u)
            xx = xy = yy = xr = yr = np.float32(0.0)
            for c in range(channels):
                tl, tr, bl, br = image[i, j, c], image[i, j + 1, c], image[i + 1, j, c], image[i + 1, j + 1, c]
                top, low = tl + (tr - tl) * fx, bl + (br - bl) * fx
                gx, gy = (tr - tl) + ((br - bl) - (tr - tl)) * fy, low - top
                r = top + gy * fy - tile[ky, kx, c]
                xx += gx * gx
                xy += gx * gy
                yy += gy * gy
                xr += gx * r
                yr += gy * r
                total += r * r
            xx0, xx1, xx2 = xx0 + xx, xx1 + xx * u, xx2 + xx * u * u
            xy0, xy1, xy2 = xy0 + xy, xy1 + xy * u, xy2 + xy * u * u
            yy0, yy1, yy2 = yy0 + yy, yy1 + yy * u, yy2 + yy * u * u
            xr0, xr1, yr0, yr1 = xr0 + xr, xr1 + xr * u, yr0 + yr, yr1 + yr * u
        jtr[0] += xr0
        jtr[1] += yr0
        jtr[2] += xr1
        jtr[3] += xr0 * v + yr1
        jtr[4] += yr0 * v
        jtj[0, 0] += xx0
        jtj[1, 0] += xy0
        jtj[1, 1] += yy0
        jtj[2, 0] += xx1
        jtj[2, 1] += xy1
        jtj[2, 2] += xx2
        jtj[3, 0] += xx0 * v + xy1
        jtj[3, 1] += xy0 * v + yy1
        jtj[3, 2] += xx1 * v + xy2
        jtj[3, 3] += xx0 * v * v + 2 * xy1 * v + yy2
        jtj[4, 0] += xy0 * v
        jtj[4, 1] += yy0 * v
        jtj[4, 2] += xy1 * v
        jtj[4, 3] += xy0 * v * v + yy1 * v
        jtj[4, 4] += yy0 * v * v
    return total / (channels * pixels * pixels)


@njit(cache=True)
def solve(jtj, jtr, damping, per_mm, isotropic, step):
    """Damped Gauss-Newton step by Cholesky; isotropic: only the offset and one scale may change."""
    n = 3 if isotropic else PARAMETERS
    a = np.zeros((n, n))
    b = np.zeros(n)
    to = (0, 1, 2, -1, 2) if isotropic else (0, 1, 2, 3, 4)
    for m in range(PARAMETERS):
        if to[m] < 0:
            continue
        b[to[m]] -= jtr[m] * per_mm
        for k in range(PARAMETERS):
            if to[k] >= 0:
                a[to[m], to[k]] += jtj[max(m, k), min(m, k)] * per_mm * per_mm
    trace = 0.0
    for m in range(n):
        trace += a[m, m]
    for m in range(n):
        a[m, m] += damping * a[m, m] + 1e-9 * trace + 1e-9
    for m in range(n):
        for k in range(m + 1):
            rest = a[m, k]
            for i in range(k):
                rest -= a[m, i] * a[k, i]
            a[m, k] = math.sqrt(rest) if k == m else rest / a[k, k]
    for m in range(n):
        for i in range(m):
            b[m] -= a[m, i] * b[i]
        b[m] /= a[m, m]
    for m in range(n - 1, -1, -1):
        for i in range(m + 1, n):
            b[m] -= a[i, m] * b[i]
        b[m] /= a[m, m]
    for m in range(PARAMETERS):
        step[m] = b[to[m]] if to[m] >= 0 else 0.0


@njit(cache=True, parallel=True)
def polish(
    tiles, levels, widths, per_mm, centres, pitch, window, step_mm, most, iterations, isotropic,
    optics, errors, offsets, maps
):
    """Polish the first ``most`` candidates of every facet in place; the arrays are those of ``search.search``.

    tiles: (F, P, P, C) display values. levels: (L, H, W, C), see ``blur_levels``; widths: (L,) mm. All candidates
    (polished or not) get their error at the sub-pixel position, so that they can be compared.
    """
    px = pitch / tiles.shape[1]
    edge = 0.5 * levels.shape[2] / per_mm
    for f in prange(len(tiles)):
        jtj, jtr = np.zeros((2, PARAMETERS, PARAMETERS)), np.zeros((2, PARAMETERS))
        step, now = np.zeros(PARAMETERS), 0
        p, q = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
        cx, cy = centres[f, 0], centres[f, 1]
        for k in range(errors.shape[1]):
            if not np.isfinite(errors[f, k]):
                continue
            p[0], p[1] = offsets[f, k, 0], offsets[f, k, 1]
            p[2], p[3], p[4] = maps[f, k, 0], maps[f, k, 1], maps[f, k, 2]
            damping = 1e-2
            best = _normal_equations(tiles[f], levels, widths, per_mm, cx, cy, px, p, jtj[now], jtr[now])
            for _ in range(iterations if k < most else 0):
                solve(jtj[now], jtr[now], damping, per_mm, isotropic, step)
                q[:] = p + step
                spread_x = 0.5 * pitch * (abs(q[2]) + abs(q[3]))
                spread_y = 0.5 * pitch * (abs(q[3]) + abs(q[4]))
                inside = (
                    not (isotropic and q[2] <= 0.0) and abs(q[0]) <= window and abs(q[1]) <= window
                    and abs(cx + q[0]) + spread_x <= edge and abs(cy + q[1]) + spread_y <= edge
                    and reachable((cx, cy), (q[0], q[1]), (q[2], q[3], q[4]), 0.5 * pitch, optics)
                )
                other, trial = 1 - now, np.inf
                if inside:
                    trial = _normal_equations(
                        tiles[f], levels, widths, per_mm, cx, cy, px, q, jtj[other], jtr[other]
                    )  # fmt: skip
                if trial < best:
                    gain, best, now = best - trial, trial, other
                    p[:] = q
                    damping *= 0.3
                    if gain < 1e-3 * best:
                        break
                else:
                    damping *= 6.0
                    if damping > 1e4:
                        break
            errors[f, k] = best + distance_term(p[0], p[1], window, step_mm)
            offsets[f, k, 0], offsets[f, k, 1] = p[0], p[1]
            maps[f, k, 0], maps[f, k, 1], maps[f, k, 2] = p[2], p[3], p[4]
