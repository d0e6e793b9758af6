"""The final error of candidates: as flat micro-facets will show them, pixel by pixel.

A flat micro-facet shows its patch unmagnified, so a lenslet's picture is a staircase: between the centres of two
micro-facets it jumps. Polishing sees the staircase only as a blur; here it is sampled as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.resuming import blocks, resumable
from magiclens.kernels.sampling import blend, clamped_cell
from magiclens.kernels.threads import in_threads
from magiclens.matching.reachability_kernels import distance_term
from magiclens.matching.tuples import Found, Tiles, Window

LOOK_UPS = 2
"""Source look-ups per side of a pixel."""


class Staircase(NamedTuple):
    """How flat micro-facets show the source.

    Args:
        microfacets: along a facet's side.
        flat_scale: mm of the source seen per mm of a flat facet.
        display: display values of evenly spaced linear light from 0 to 1.
    """

    microfacets: int
    flat_scale: float
    display: FloatArray


# not plain fastmath, which takes infinity, the sign of an empty place, for impossible
@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _evaluate_facet(f, tiles, source, per_mm, stairs, window, found):
    """Replace the errors of the candidates of facet f, see ``evaluate``."""
    channels, pixels = tiles.values.shape[1], tiles.values.shape[2]
    height, width = source.shape[1], source.shape[2]
    pitch, table = tiles.pitch, stairs.display
    scale = (len(table) - 1) / (LOOK_UPS * LOOK_UPS)
    cell, side = pitch / stairs.microfacets, pixels * LOOK_UPS
    # of the look-ups along a side: the middle of the micro-facet, and what the look-up sees from there
    middles, besides = np.empty(side), np.empty(side)
    for i in range(side):
        u = (i + 0.5) * pitch / side
        middle = (math.floor(u / cell) + 0.5) * cell
        middles[i], besides[i] = middle - 0.5 * pitch, stairs.flat_scale * (u - middle)
    light = np.zeros(channels, np.float32)
    for k in range(found.errors.shape[1]):
        if not np.isfinite(found.errors[f, k]):
            continue
        (xx, xy, yy), total = (found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2]), 0.0
        x0, y0 = tiles.centres[f, 0] + found.offsets[f, k, 0], tiles.centres[f, 1] + found.offsets[f, k, 1]
        for p in range(pixels * pixels):
            light[:] = 0.0
            for s in range(LOOK_UPS * LOOK_UPS):
                i, j = p % pixels * LOOK_UPS + s % LOOK_UPS, p // pixels * LOOK_UPS + s // LOOK_UPS
                x = (x0 + xx * middles[i] + xy * middles[j] + besides[i]) * per_mm + 0.5 * width - 0.5
                y = (y0 + xy * middles[i] + yy * middles[j] + besides[j]) * per_mm + 0.5 * height - 0.5
                if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                    continue  # beside the source it is dark
                ix, iy, dx, dy = clamped_cell(x, y, width, height)
                fx, fy = np.float32(dx), np.float32(dy)
                for c in range(channels):
                    light[c] += blend(source[c, iy, ix : ix + 2], source[c, iy + 1, ix : ix + 2], fx, fy)
            for c in range(channels):
                seen = table[int(light[c] * scale + 0.5)]
                total += (seen - tiles.values[f, c, p // pixels, p % pixels]) ** 2
        far = distance_term(found.offsets[f, k, 0], found.offsets[f, k, 1], window)
        found.errors[f, k] = total / (channels * pixels * pixels) + far


@njit(cache=True, nogil=True)
def _evaluate_part(part, tiles, source, per_mm, stairs, window, found):
    """Part of the facets, see ``evaluate``."""
    for f in range(part.first, part.end):
        _evaluate_facet(f, tiles, source, per_mm, stairs, window, found)


def evaluate(tiles: Tiles, source: FloatArray, per_mm: float, stairs: Staircase, window: Window, found: Found) -> None:
    """Replace candidates' errors by what flat micro-facets show; inf stays.

    ``error = mean over pixels of (display(mean light of the look-ups) - tile)^2 + distance_term`` with the look-up of a
    point p in the micro-facet centred at a at ``c + R + M a + flat_scale (p - a)``.

    Args:
        tiles: ``Tiles`` (F, C, P, P).
        source: (C, H, W) float32, linear light.
        per_mm: source pixels per mm.
        stairs: how flat micro-facets show the source.
        window: the search window.
        found: the candidates; their errors are updated in place.
    """
    for block in resumable(blocks(len(tiles.centres)), *found):
        in_threads(_evaluate_part, block, tiles, source, per_mm, stairs, window, found)
