"""Kernels that match several eyes at once: search, polishing and judging with exact refraction for every eye (4.6).

A candidate is what the reference eye sees; ``optics.eyes.linearise`` says what the others then see, and where in their
pictures. The errors of all views are averaged. Coordinates are those of images (y down); arrays of candidates are
those of ``search.search``. Views that share a source share its rasters: ``which[v]`` names the source of view v.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.matching.polish import PARAMETERS, sample, solve
from magiclens.matching.search import distance_term, reachable
from magiclens.optics.eyes import linearise, local_map, shift, unknown_first_order

BLOCKS = 4
"""The search compares tiles of BLOCKS x BLOCKS means."""
REFRESH = 4
"""The search refracts exactly at every so many offsets of a row, and goes on linearly between."""
SAMPLES = 2
"""Source look-ups per side of a pixel when judging."""


@njit(cache=True)
def _cut_tile(targets, cx, cy, pitch, size, seen, tile):
    """The means of a facet's tile (V, C, B, B) where each eye sees the facet; targets: (V, C, T, T) of N B = T."""
    per_mm = targets.shape[2] / size
    half = 0.5 * targets.shape[2] - 0.5
    for v in range(tile.shape[0]):
        for c in range(tile.shape[1]):
            for by in range(BLOCKS):
                for bx in range(BLOCKS):
                    x = (seen.position[v, 0] + ((bx + 0.5) / BLOCKS - 0.5) * pitch) * per_mm + half
                    y = (seen.position[v, 1] + ((by + 0.5) / BLOCKS - 0.5) * pitch) * per_mm + half
                    tile[v, c, by, bx] = sample(targets[v, c], x, y)[0]


@njit(cache=True)
def _inside(seen, v, g, half_pitch, half_source):
    """Does the whole patch lie on the source?"""
    wide, tall = half_pitch * (abs(g[0]) + abs(g[1])), half_pitch * (abs(g[2]) + abs(g[3]))
    return abs(seen.landing[v, 0]) + wide <= half_source and abs(seen.landing[v, 1]) + tall <= half_source


# not plain fastmath: the limit is infinite until a bucket has a candidate
@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _difference(tile, images, which, per_mm, pitch, seen, maps, limit):
    """Sum of squared differences of the tile's means and the patches', nearest pixel; stops once above the limit."""
    views, channels = tile.shape[0], tile.shape[1]
    half = 0.5 * images.shape[3]
    cell = pitch / BLOCKS
    total = 0.0
    for v in range(views):
        image, m = images[which[v]], maps[v]
        for by in range(BLOCKS):
            w = (by + 0.5 - 0.5 * BLOCKS) * cell
            for bx in range(BLOCKS):
                u = (bx + 0.5 - 0.5 * BLOCKS) * cell
                x = int((seen.landing[v, 0] + m[0] * u + m[1] * w) * per_mm + half)
                y = int((seen.landing[v, 1] + m[2] * u + m[3] * w) * per_mm + half)
                for c in range(channels):
                    d = tile[v, c, by, bx] - image[c, y, x]
                    total += d * d
        if total > limit:
            break
    return total


@njit(cache=True, parallel=True)
def search(
    targets, images, which, scales, per_mm, centres, heights, pitch, size, window, step, buckets, mirrored,
    eyes, optics, errors, offsets, maps
):
    """Try every offset and every map of the lattice for every facet; keep the best per bucket of the offset window.

    targets: (V, C, N B, N B) display values. images: (L, S, C, H, W) display values, the sources averaged over the
    patches' blocks under the maps diag(+-scales[l, 0], +-scales[l, 1]). heights: (F,) mm, of the facets' centres.
    """
    views, channels = targets.shape[0], targets.shape[1]
    n = 2 * int(window / step) + 1
    norm = 1.0 / (views * channels * BLOCKS * BLOCKS)
    half_source = 0.5 * images.shape[3] / per_mm - 1.0 / per_mm
    half = 0.5 * pitch
    for f in prange(len(centres)):
        tile = np.zeros((views, channels, BLOCKS, BLOCKS), np.float32)
        seen, g, m = unknown_first_order(views), np.zeros((views, 4)), np.zeros(3)
        cx, cy = centres[f, 0], centres[f, 1]
        lit = True
        for v in range(views):
            lit &= linearise(eyes[v], (cx, cy, heights[f]), (0.0, 0.0), optics.eye, optics, True, seen, v)
        if not lit:
            continue
        _cut_tile(targets, cx, cy, pitch, size, seen, tile)
        for j in range(n):
            ry = (j - n // 2) * step
            for i in range(n):
                rx = (i - n // 2) * step
                if i % REFRESH == 0:
                    lit = True
                for v in range(views):
                    if i % REFRESH == 0:
                        lit &= linearise(eyes[v], (cx, cy, heights[f]), (rx, ry), optics.eye, optics, False, seen, v)
                    else:  # a few steps along the derivative by the source point, whose change over them is tiny
                        shift(seen, v, step)
                if not lit:
                    continue
                kx = min(int((rx + window) / (2.0 * window) * buckets), buckets - 1)
                ky = min(int((ry + window) / (2.0 * window) * buckets), buckets - 1)
                k = ky * buckets + kx
                far = distance_term(rx, ry, window, step)
                for pair in range(len(scales)):
                    for sign in range(4 if mirrored else 1):
                        m[0] = -scales[pair, 0] if sign & 1 else scales[pair, 0]
                        m[2] = -scales[pair, 1] if sign & 2 else scales[pair, 1]
                        ok = True
                        for v in range(views):
                            local_map(seen, v, m, g[v])
                            ok &= _inside(seen, v, g[v], half, half_source)
                        if not ok:
                            continue
                        limit = (errors[f, k] - far) / norm
                        total = _difference(tile, images[pair], which, per_mm, pitch, seen, g, limit)
                        if total < limit and reachable(
                            (cx, cy), (rx, ry), (m[0], 0.0, m[2]), half, optics
                        ):
                            errors[f, k] = total * norm + far
                            offsets[f, k, 0], offsets[f, k, 1] = rx, ry
                            maps[f, k, 0], maps[f, k, 1], maps[f, k, 2] = m[0], 0.0, m[2]


@njit(cache=True)
def _look(eyes, facet, p, half_pitch, half_source, optics, seen, g):
    """Fill the first order and local maps (V, 4) of a candidate; False if an eye misses the source."""
    for v in range(len(eyes)):
        if not linearise(eyes[v], facet, (p[0], p[1]), optics.eye, optics, True, seen, v):
            return False
        local_map(seen, v, p[2:], g[v])
        if not _inside(seen, v, g[v], half_pitch, half_source):
            return False
    return True


@njit(cache=True, fastmath=True)
def _normal_equations(targets, levels, widths, which, per_mm, size, pitch, pixels, seen, g, jtj, jtr, derive):
    """Mean squared difference of a candidate; J^T J and J^T r too if ``derive``. See ``polish._normal_equations``."""
    views, channels = targets.shape[0], targets.shape[1]
    px = pitch / pixels
    half = 0.5 * levels.shape[4] - 0.5
    target_per_mm = targets.shape[2] / size
    target_half = 0.5 * targets.shape[2] - 0.5
    j = np.zeros(PARAMETERS, np.float32)
    if derive:
        jtj[:] = 0.0
        jtr[:] = 0.0
    total = np.float32(0.0)
    for v in range(views):
        m, landing, by_source = g[v], seen.landing[v], seen.by_source[v]
        position, spread = seen.position[v], seen.position_by_facet[v]
        footprint = px * math.sqrt(abs(m[0] * m[3] - m[1] * m[2]))
        level = 0
        while level + 1 < len(widths) and widths[level + 1] < 1.4 * footprint:
            level += 1
        for ky in range(pixels):
            w = (ky - 0.5 * (pixels - 1)) * px
            for kx in range(pixels):
                u = (kx - 0.5 * (pixels - 1)) * px
                x = (landing[0] + m[0] * u + m[1] * w) * per_mm + half
                y = (landing[1] + m[2] * u + m[3] * w) * per_mm + half
                tx = (position[0] + spread[0, 0] * u + spread[0, 1] * w) * target_per_mm + target_half
                ty = (position[1] + spread[1, 0] * u + spread[1, 1] * w) * target_per_mm + target_half
                for c in range(channels):
                    value, gx, gy = sample(levels[level, which[v], c], x, y)
                    r = value - sample(targets[v, c], tx, ty)[0]
                    total += r * r
                    if derive:
                        # along the reference eye's source point, which the parameters move
                        hx = gx * by_source[0, 0] + gy * by_source[1, 0]
                        hy = gx * by_source[0, 1] + gy * by_source[1, 1]
                        j[0], j[1] = hx, hy
                        j[2], j[3], j[4] = hx * u, hx * w + hy * u, hy * w
                        for a in range(PARAMETERS):
                            jtr[a] += j[a] * r
                            for b in range(a + 1):
                                jtj[a, b] += j[a] * j[b]
    return total / (views * channels * pixels * pixels)


@njit(cache=True, parallel=True)
def polish(
    targets, levels, widths, which, per_mm, centres, heights, pitch, size, pixels, window, step_mm, most, iterations,
    isotropic, eyes, optics, errors, offsets, maps
):
    """Polish the first ``most`` candidates of every facet in place by Levenberg-Marquardt; all get their new error.

    targets: (V, C, T, T) display values. levels: (L, S, C, H, W), see ``polish.blur_levels``; widths: (L,) mm.
    """
    views = len(eyes)
    half_source = 0.5 * levels.shape[4] / per_mm
    for f in prange(len(centres)):
        jtj, jtr = np.zeros((PARAMETERS, PARAMETERS), np.float32), np.zeros(PARAMETERS, np.float32)
        step, p, q = np.zeros(PARAMETERS), np.zeros(PARAMETERS), np.zeros(PARAMETERS)
        seen, g = unknown_first_order(views), np.zeros((views, 4))
        cx, cy, h = centres[f, 0], centres[f, 1], heights[f]
        for k in range(errors.shape[1]):
            if not np.isfinite(errors[f, k]):
                continue
            p[:2], p[2:] = offsets[f, k], maps[f, k]
            if not _look(eyes, (cx, cy, h), p, 0.5 * pitch, half_source, optics, seen, g):
                errors[f, k] = np.inf
                continue
            damping = 1e-2
            best = _normal_equations(
                targets, levels, widths, which, per_mm, size, pitch, pixels, seen, g, jtj, jtr, k < most
            )
            for _ in range(iterations if k < most else 0):
                solve(jtj, jtr, damping, per_mm, isotropic, step)
                q[:] = p + step
                trial = np.float32(np.inf)
                if (
                    not (isotropic and q[2] <= 0.0) and abs(q[0]) <= window and abs(q[1]) <= window
                    and reachable(
                        (cx, cy), (q[0], q[1]), (q[2], q[3], q[4]), 0.5 * pitch, optics
                    )
                    and _look(eyes, (cx, cy, h), q, 0.5 * pitch, half_source, optics, seen, g)
                ):
                    trial = _normal_equations(
                        targets, levels, widths, which, per_mm, size, pitch, pixels, seen, g, jtj, jtr, False
                    )
                if trial < best:
                    gain = best - trial
                    p[:] = q
                    damping *= 0.3
                    best = _normal_equations(
                        targets, levels, widths, which, per_mm, size, pitch, pixels, seen, g, jtj, jtr, True
                    )
                    if gain < 1e-3 * best:
                        break
                else:
                    damping *= 6.0
                    if damping > 1e4:
                        break
            errors[f, k] = best + distance_term(p[0], p[1], window, step_mm)
            offsets[f, k], maps[f, k] = p[:2], p[2:]


@njit(cache=True, parallel=True, fastmath={"contract", "reassoc", "arcp"})
def judge(
    targets, sources, which, per_mm, centres, heights, pitch, size, pixels, microfacets, window, step, table,
    eyes, optics, errors, offsets, maps
):
    """The last word on candidates, as of ``judge.judge``: sources (S, C, H, W) in linear light, staircases and all."""
    views, channels = targets.shape[0], targets.shape[1]
    half = 0.5 * sources.shape[3] - 0.5
    last_x = sources.shape[3] - 1.001
    target_per_mm = targets.shape[2] / size
    target_half = 0.5 * targets.shape[2] - 0.5
    scale = (len(table) - 1) / (SAMPLES * SAMPLES)
    cell, sub, px = pitch / microfacets, pitch / (pixels * SAMPLES), pitch / pixels
    for f in prange(len(centres)):
        seen, g = unknown_first_order(views), np.zeros((views, 4))
        light, p = np.zeros(channels, np.float32), np.zeros(PARAMETERS)
        for k in range(errors.shape[1]):
            if not np.isfinite(errors[f, k]):
                continue
            p[:2], p[2:] = offsets[f, k], maps[f, k]
            facet = (centres[f, 0], centres[f, 1], heights[f])
            if not _look(eyes, facet, p, 0.5 * pitch, np.inf, optics, seen, g):
                errors[f, k] = np.inf
                continue
            total = 0.0
            for v in range(views):
                m, source, landing, flat = g[v], sources[which[v]], seen.landing[v], seen.flat_by_facet[v]
                position, spread = seen.position[v], seen.position_by_facet[v]
                for pixel in range(pixels * pixels):
                    light[:] = 0.0
                    for n in range(SAMPLES * SAMPLES):
                        u = ((pixel % pixels) * SAMPLES + n % SAMPLES + 0.5) * sub
                        w = ((pixel // pixels) * SAMPLES + n // SAMPLES + 0.5) * sub
                        a, b = (math.floor(u / cell) + 0.5) * cell, (math.floor(w / cell) + 0.5) * cell
                        du, dw = u - a, w - b
                        a, b = a - 0.5 * pitch, b - 0.5 * pitch
                        x = landing[0] + m[0] * a + m[1] * b + flat[0, 0] * du + flat[0, 1] * dw
                        y = landing[1] + m[2] * a + m[3] * b + flat[1, 0] * du + flat[1, 1] * dw
                        x, y = x * per_mm + half, y * per_mm + half
                        if abs(x - half) > half + 0.5 or abs(y - half) > half + 0.5:
                            continue  # beside the source it is dark
                        x, y = min(max(x, 0.0), last_x), min(max(y, 0.0), last_x)
                        ix, iy = int(x), int(y)
                        fx, fy = np.float32(x - ix), np.float32(y - iy)
                        for c in range(channels):
                            top = source[c, iy, ix] + (source[c, iy, ix + 1] - source[c, iy, ix]) * fx
                            low = source[c, iy + 1, ix] + (source[c, iy + 1, ix + 1] - source[c, iy + 1, ix]) * fx
                            light[c] += top + (low - top) * fy
                    u, w = (pixel % pixels + 0.5) * px - 0.5 * pitch, (pixel // pixels + 0.5) * px - 0.5 * pitch
                    tx = (position[0] + spread[0, 0] * u + spread[0, 1] * w) * target_per_mm + target_half
                    ty = (position[1] + spread[1, 0] * u + spread[1, 1] * w) * target_per_mm + target_half
                    for c in range(channels):
                        d = table[int(light[c] * scale + 0.5)] - sample(targets[v, c], tx, ty)[0]
                        total += d * d
            far = distance_term(offsets[f, k, 0], offsets[f, k, 1], window, step)
            errors[f, k] = total / (views * channels * pixels * pixels) + far
