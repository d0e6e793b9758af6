"""The last word on candidates: their error as flat micro-facets will show them, pixel by pixel.

A flat micro-facet shows its patch unmagnified, so a lenslet's picture is a staircase: between the centres of two
micro-facets it jumps. Polishing sees the staircase only as a blur; here it is sampled as it is.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from magiclens.matching.search import distance_term

SAMPLES = 2
"""Source look-ups per side of a pixel."""


# not plain fastmath, which takes infinity, the sign of an empty place, for impossible
@njit(cache=True, parallel=True, fastmath={"contract", "reassoc", "arcp"})
def judge(tiles, source, per_mm, centres, pitch, microfacets, spread, window, step, table, errors, offsets, maps):
    """Replace ``errors`` (F, K) by mean squared differences of display values plus the distance term; inf stays.

    tiles: (F, C, P, P) display values. source: (C, H, W) linear light. spread: mm of the source seen per mm of a flat
    facet. window, step: see ``distance_term``. offsets (F, K, 2), maps (F, K, 3): image frame (y down), mm.
    """
    channels, pixels = tiles.shape[1], tiles.shape[2]
    height, width = source.shape[1], source.shape[2]
    scale = (len(table) - 1) / (SAMPLES * SAMPLES)
    cell, sub = pitch / microfacets, pitch / (pixels * SAMPLES)
    for f in prange(len(tiles)):
        light = np.zeros(channels, np.float32)
        for k in range(errors.shape[1]):
            if not np.isfinite(errors[f, k]):
                continue
            m, total = maps[f, k], 0.0
            x0, y0 = centres[f, 0] + offsets[f, k, 0], centres[f, 1] + offsets[f, k, 1]
            for p in range(pixels * pixels):
                light[:] = 0.0
                for s in range(SAMPLES * SAMPLES):
                    u = ((p % pixels) * SAMPLES + s % SAMPLES + 0.5) * sub
                    v = ((p // pixels) * SAMPLES + s // SAMPLES + 0.5) * sub
                    a, b = (math.floor(u / cell) + 0.5) * cell, (math.floor(v / cell) + 0.5) * cell
                    du, dv = spread * (u - a), spread * (v - b)
                    a, b = a - 0.5 * pitch, b - 0.5 * pitch
                    x = (x0 + m[0] * a + m[1] * b + du) * per_mm + 0.5 * width - 0.5
                    y = (y0 + m[1] * a + m[2] * b + dv) * per_mm + 0.5 * height - 0.5
                    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                        continue  # beside the source it is dark
                    x, y = min(max(x, 0.0), width - 1.001), min(max(y, 0.0), height - 1.001)
                    ix, iy = int(x), int(y)
                    fx, fy = np.float32(x - ix), np.float32(y - iy)
                    for c in range(channels):
                        top = source[c, iy, ix] + (source[c, iy, ix + 1] - source[c, iy, ix]) * fx
                        low = source[c, iy + 1, ix] + (source[c, iy + 1, ix + 1] - source[c, iy + 1, ix]) * fx
                        light[c] += top + (low - top) * fy
                for c in range(channels):
                    seen = table[int(light[c] * scale + 0.5)]
                    total += (seen - tiles[f, c, p // pixels, p % pixels]) ** 2
            far = distance_term(offsets[f, k, 0], offsets[f, k, 1], window, step)
            errors[f, k] = total / (channels * pixels * pixels) + far
