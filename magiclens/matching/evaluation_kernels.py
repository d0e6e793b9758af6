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
from magiclens.kernels.lanes import LANES, keep_lanes, lanes_at, no_lanes
from magiclens.kernels.resuming import blocks, resumable
from magiclens.kernels.sampling import blend
from magiclens.kernels.threads import in_threads
from magiclens.kernels.uncounted import uncounted
from magiclens.matching.look_up_kernels import look, places_for
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


@njit(cache=True)
def _places_on_stairs(tiles, per_mm, stairs):
    """The ``Places`` of a tile: of each, the middle of its micro-facet, and how far beside that it looks."""
    pixels, cell = tiles.values.shape[1], tiles.pitch / stairs.microfacets
    found, apart = places_for((pixels * LOOK_UPS) ** 2), tiles.pitch / (pixels * LOOK_UPS)
    for n in range(len(found.u)):
        k, s = n // (LOOK_UPS * LOOK_UPS), n % (LOOK_UPS * LOOK_UPS)
        x = (k % pixels * LOOK_UPS + s % LOOK_UPS + 0.5) * apart
        y = (k // pixels * LOOK_UPS + s // LOOK_UPS + 0.5) * apart
        middle_x, middle_y = (math.floor(x / cell) + 0.5) * cell, (math.floor(y / cell) + 0.5) * cell
        found.u[n], found.v[n] = middle_x - 0.5 * tiles.pitch, middle_y - 0.5 * tiles.pitch
        found.beside_x[n] = stairs.flat_scale * (x - middle_x) * per_mm
        found.beside_y[n] = stairs.flat_scale * (y - middle_y) * per_mm
    return found


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _difference(f, tiles, source, places, display, light):
    """Mean squared difference of facet f's tile and of what its look-ups show; light: (LANES,) float32, overwritten."""
    _, pixels, _, channels = tiles.values.shape
    right, down = np.uint64(channels), np.uint64(source.shape[1] * channels)
    scale, total = np.float32((len(display) - 1) / (LOOK_UPS * LOOK_UPS)), 0.0
    for c in range(0, channels, LANES):
        for k in range(pixels * pixels):
            sum_ = no_lanes()
            for n in range(np.uint64(k * LOOK_UPS * LOOK_UPS), np.uint64((k + 1) * LOOK_UPS * LOOK_UPS)):
                at = np.uint64(places.first[n] + c)
                upper = lanes_at(source, at), lanes_at(source, at + right)
                lower = lanes_at(source, at + down), lanes_at(source, at + down + right)
                sum_ = sum_ + blend(upper, lower, places.right[n], places.below[n]) * places.light[n]
            keep_lanes(light, np.uint64(0), sum_)
            for lane in range(min(LANES, channels - c)):
                seen = display[int(light[lane] * scale + np.float32(0.5))]
                total += (seen - tiles.values[f, k // pixels, k % pixels, c + lane]) ** 2
    return total / (channels * pixels * pixels)


@njit(cache=True)
def _evaluate_facet(f, tiles, source, per_mm, stairs, window, found):
    """Replace the errors of the candidates of facet f, see ``evaluate``."""
    places, light = _places_on_stairs(tiles, per_mm, stairs), np.zeros(LANES, np.float32)
    tiles, source = uncounted(tiles), uncounted(source)
    for k in range(found.errors.shape[1]):
        if not np.isfinite(found.errors[f, k]):
            continue
        rx, ry = found.offsets[f, k, 0], found.offsets[f, k, 1]
        m = (found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2])
        look(places, (tiles.centres[f, 0] + rx, tiles.centres[f, 1] + ry), m, per_mm, source.shape)
        difference = _difference(f, tiles, source, places, stairs.display, light)
        found.errors[f, k] = difference + distance_term(rx, ry, window)


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
        tiles: ``Tiles`` (F, P, P, C), with room for lanes.
        source: (H, W, C) float32, linear light, with room for lanes.
        per_mm: source pixels per mm.
        stairs: how flat micro-facets show the source.
        window: the search window.
        found: the candidates; their errors are updated in place.
    """
    for block in resumable(blocks(len(tiles.centres)), *found):
        in_threads(_evaluate_part, block, tiles, source, per_mm, stairs, window, found)
