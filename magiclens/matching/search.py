"""The exhaustive search: every offset in the window, for one raster and all four signs of its map.

A candidate's squared difference is bounded from below by that of the means of BLOCK x BLOCK pixel blocks (the
mean of squares is at least the square of the mean). The bound is computed for whole rows of offsets at
once; only offsets that may still enter their bucket are compared pixel by pixel.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.matching.raster import BLOCK
from magiclens.optics.refraction import facet_normal


@njit(cache=True)
def reachable(centre, offset, m, half, optics):
    """Can a facet show this patch, facing the eye and below the slope limit? Checked at its centre and four corners.

    Args:
        centre: x, y of the facet, mm, image frame (y down).
        offset: x, y of the patch from the facet, mm.
        m: map of the patch (xx, xy, yy).
        half: half the pitch, mm.
        optics: ``Optics`` in the image frame.
    """
    (cx, cy), (rx, ry), (xx, xy, yy) = centre, offset, m
    eye = optics.eye
    for k in range(5):
        px = 0.0 if k == 4 else (half if k & 1 else -half)
        py = 0.0 if k == 4 else (half if k & 2 else -half)
        sx, sy = cx + rx + xx * px + xy * py, cy + ry + xy * px + yy * py
        x, y = cx + px, cy + py
        n = facet_normal(eye, (x, y, optics.depth), (sx, sy), optics)
        faces_eye = n[0] * (eye[0] - x) + n[1] * (eye[1] - y) + n[2] * (eye[2] - optics.depth) > 0.0
        if n[2] < optics.cos_limit or not faces_eye:
            return False
    return True


@njit(cache=True)
def distance_term(rx: float, ry: float, window: float, step: float) -> float:
    """lambda M_s of 4.2 per pixel of a tile, in display units: 1 / (m^2 - R^2) - 1 / m^2, R in search steps."""
    m2 = (2.0 * window / step) ** 2
    return 1.0 / (m2 - (rx * rx + ry * ry) / (step * step)) - 1.0 / m2


@njit(cache=True)
def _places(first, skip, stride, phases, indices):
    """Phase and index (see ``raster.build``) of the samples of consecutive tile pixels, from sample ``first`` on."""
    for k in range(len(phases)):
        phases[k] = (first + k * skip) % stride
        indices[k] = (first + k * skip) // stride


# not plain fastmath: the limit is infinite until a bucket has a candidate
@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _difference(tile, raster, phase_y, at_y, phase_x, at_x, n, limit):
    """Sum of squared differences of a tile against the raster, n offsets to the right; stops once above the limit."""
    channels, pixels, _ = tile.shape
    total = np.float32(0.0)
    for ky in range(pixels):
        for c in range(channels):
            for kx in range(pixels):
                d = tile[c, ky, kx] - raster[c, phase_y[ky], phase_x[kx], at_y[ky], at_x[kx] + n]
                total += d * d
        if total > limit:
            break
    return total


@njit(cache=True, fastmath=True)
def _bound_row(acc, count, blocks, means, phase_y, at_y, phase_x, at_x):
    """acc[n] = lower bound of the sum of squared differences at the n-th offset of a row."""
    channels, per_side, _ = blocks.shape
    weight = np.float32(BLOCK * BLOCK)
    for c in range(channels):
        for by in range(per_side):
            for bx in range(per_side):
                ky, kx = by * BLOCK, bx * BLOCK
                row = means[c, phase_y[ky], phase_x[kx], at_y[ky], at_x[kx] : at_x[kx] + count]
                t = blocks[c, by, bx]
                if c + by + bx == 0:
                    for n in range(count):
                        d = t - row[n]
                        acc[n] = weight * d * d
                else:
                    for n in range(count):
                        d = t - row[n]
                        acc[n] += weight * d * d


@njit(cache=True)
def _span(centre, window, spacing, mid, last, stride):
    """First samples of patches that lie inside the source, their centres in the window: the first, and how many."""
    first = max(0, math.ceil((centre - window) / spacing - mid))
    last = min(last, math.floor((centre + window) / spacing - mid))
    return first, (last - first) // stride + 1


@njit(cache=True, parallel=True)
def search(
    tiles, blocks, raster, means, scale_x, scale_y, spacing_x, spacing_y, count_x, count_y, skip_x, skip_y,
    centres, window, step, buckets, mirrored, optics, errors, offsets, maps
):
    """Try every offset of one raster for every facet; keep the best per bucket of the offset window.

    tiles: (F, C, P, P). blocks: (F, C, P / BLOCK, P / BLOCK), their means. raster, means: see ``raster.build``.
    centres: (F, 2) mm, y down. window: half the search window, mm. buckets: per side of the window.
    errors (F, K), offsets (F, K, 2), maps (F, K, 3), K = buckets^2, are updated in place; y down.
    """
    facets, channels, pixels, _ = tiles.shape
    sy, sx = raster.shape[1], raster.shape[2]
    norm = np.float32(1.0 / (channels * pixels * pixels))
    reach_x, reach_y = (pixels - 1) * skip_x, (pixels - 1) * skip_y
    mid_x, mid_y = 0.5 * (reach_x - count_x + 1), 0.5 * (reach_y - count_y + 1)
    half = 0.5 * pixels * spacing_x * skip_x / scale_x
    for f in prange(facets):
        acc = np.zeros(raster.shape[4] + 1, np.float32)
        edges = np.zeros(buckets + 1, np.int64)
        phase_x, at_x = np.zeros(pixels, np.int64), np.zeros(pixels, np.int64)
        phase_y, at_y = np.zeros(pixels, np.int64), np.zeros(pixels, np.int64)
        cx, cy = centres[f, 0], centres[f, 1]
        x0, n_x = _span(cx, window, spacing_x, mid_x, count_x - 1 - reach_x, sx)
        y0, n_y = _span(cy, window, spacing_y, mid_y, count_y - 1 - reach_y, sy)
        if n_x < 1 or n_y < 1:
            continue
        _places(x0, skip_x, sx, phase_x, at_x)
        edges[buckets] = n_x
        for b in range(1, buckets):
            left = (cx - window + 2.0 * window * b / buckets) / spacing_x - mid_x - x0
            edges[b] = min(max(math.ceil(left / sx), 0), n_x)
        for sign in range(4 if mirrored else 1):
            flip_x, flip_y = (sign & 1) == 1, (sign & 2) == 2
            xx, yy = -scale_x if flip_x else scale_x, -scale_y if flip_y else scale_y
            tile = tiles[f, :, :: -1 if flip_y else 1, :: -1 if flip_x else 1]
            block = blocks[f, :, :: -1 if flip_y else 1, :: -1 if flip_x else 1]
            for j in range(n_y):
                ry = (y0 + j * sy + mid_y) * spacing_y - cy
                bucket_y = min(max(int((ry + window) / (2.0 * window) * buckets), 0), buckets - 1)
                _places(y0 + j * sy, skip_y, sy, phase_y, at_y)
                _bound_row(acc, n_x, block, means, phase_y, at_y, phase_x, at_x)
                for b in range(buckets):
                    k = bucket_y * buckets + b
                    limit = errors[f, k] / norm
                    for n in range(edges[b], edges[b + 1]):
                        if acc[n] >= limit:
                            continue
                        rx = (x0 + n * sx + mid_x) * spacing_x - cx
                        far = np.float32(distance_term(rx, ry, window, step) / norm)
                        if acc[n] + far >= limit:
                            continue
                        ssd = _difference(tile, raster, phase_y, at_y, phase_x, at_x, n, limit - far) + far
                        if ssd >= limit:
                            continue
                        if reachable((cx, cy), (rx, ry), (xx, 0.0, yy), half, optics):
                            limit = ssd
                            errors[f, k] = ssd * norm
                            offsets[f, k, 0], offsets[f, k, 1] = rx, ry
                            maps[f, k, 0], maps[f, k, 1], maps[f, k, 2] = xx, 0.0, yy
