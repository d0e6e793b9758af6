"""Kernels that match several eyes at once: search, polishing and evaluation with exact refraction for every eye (4.6).

A candidate is what the reference eye sees; ``optics.eyes.linearise`` says what the others then see, and where in their
pictures. The errors of all views are averaged. Coordinates are those of images (y down). Views that share a source
share its rasters.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.resuming import blocks, resumable
from magiclens.kernels.sampling import bilinear, blend, clamped_cell
from magiclens.kernels.threads import in_threads
from magiclens.matching.evaluation_kernels import LOOK_UPS, Staircase
from magiclens.matching.polishing_kernels import (
    PARAMETERS,
    PIXEL_WIDTHS,
    polishing_step,
    read_candidate,
    write_candidate,
)
from magiclens.matching.reachability_kernels import distance_term, reachable
from magiclens.matching.tuples import Found, Levels, PolishingRule, Window
from magiclens.optics.eyes import FirstOrder, linearise, local_map, shift, unknown_first_order
from magiclens.optics.medium import Optics

BLOCKS = 4
"""Blocks along a tile's side, whose means the search compares."""
_REFRESH = 4
"""Offsets of a row between two exact refractions of the search, which goes on linearly between."""


class Views(NamedTuple):
    """What the eyes see and shall see, lens frame.

    Args:
        eyes: (V, 3) mm.
        targets: (V, C, T, T) float32 display values, over the lens's square.
        which: (V,) source of each view.
        per_mm: source pixels per mm.
        size: side of the lens, mm.
    """

    eyes: FloatArray
    targets: FloatArray
    which: IntArray
    per_mm: float
    size: float


class Facets(NamedTuple):
    """Where the facets are.

    Args:
        centres: (F, 2) mm.
        heights: (F,) of the centres above the reference plane, mm.
        pitch: side of a facet, mm.
    """

    centres: FloatArray
    heights: FloatArray
    pitch: float


class Trials(NamedTuple):
    """The maps that the search tries.

    Args:
        scales: (L, 2) magnitudes along x and y.
        images: (L, S, C, H, W) float32 display values: the sources averaged over the blocks of a patch.
        mirrored: whether maps of either sign are tried.
    """

    scales: FloatArray
    images: FloatArray
    mirrored: bool


class _Sighting(NamedTuple):
    """What all eyes see of one facet: to first order, and the local maps (V, 4) of a candidate."""

    seen: FirstOrder
    maps: FloatArray


@njit(cache=True)
def _cut_tile(views, pitch, seen, tile):
    """Fill the means of a facet's tile (V, C, B, B) where each eye sees the facet; targets: (V, C, N B, N B)."""
    targets = views.targets
    per_mm = targets.shape[2] / views.size
    half = 0.5 * targets.shape[2] - 0.5
    for v in range(tile.shape[0]):
        for c in range(tile.shape[1]):
            for by in range(BLOCKS):
                for bx in range(BLOCKS):
                    x = (seen.position[v, 0] + ((bx + 0.5) / BLOCKS - 0.5) * pitch) * per_mm + half
                    y = (seen.position[v, 1] + ((by + 0.5) / BLOCKS - 0.5) * pitch) * per_mm + half
                    tile[v, c, by, bx] = bilinear(targets[v, c], x, y)[0]


@njit(cache=True)
def _inside(seen, v, g, half_pitch, half_source):
    """Does the whole patch lie on the source?"""
    wide, tall = half_pitch * (abs(g[0]) + abs(g[1])), half_pitch * (abs(g[2]) + abs(g[3]))
    return abs(seen.landing[v, 0]) + wide <= half_source and abs(seen.landing[v, 1]) + tall <= half_source


# not plain fastmath: the limit is infinite until a bucket has a candidate
@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _difference(tile, images, views, pitch, seen, maps, limit):
    """Sum of squared differences of the tile's means and the patches', nearest pixel; stops once above the limit."""
    which, per_mm = views.which, views.per_mm
    channels = tile.shape[1]
    half = 0.5 * images.shape[3]
    cell = pitch / BLOCKS
    total = 0.0
    for v in range(tile.shape[0]):
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


@njit(cache=True)
def _sight(views, facet, offset, optics, whole, seen):
    """Refract exactly for all eyes; False where the light of one is reflected totally. See ``linearise``."""
    lit = True
    for v in range(len(views.eyes)):
        lit &= linearise(views.eyes[v], facet, offset, optics.eye, optics, whole, seen, v)
    return lit


@njit(cache=True)
def _maps_on_source(sighting, m, half_pitch, half_source):
    """Fill the local maps of a candidate whose first order is known; do all patches lie on the source?"""
    ok = True
    for v in range(len(sighting.maps)):
        local_map(sighting.seen, v, m, sighting.maps[v])
        ok &= _inside(sighting.seen, v, sighting.maps[v], half_pitch, half_source)
    return ok


@njit(cache=True)
def _search_facet(f, views, facets, trials, window, optics, found):
    """Try every offset and every map for facet f, see ``search_views``."""
    count, channels = views.targets.shape[0], views.targets.shape[1]
    n = 2 * int(window.half / window.step) + 1
    norm = 1.0 / (count * channels * BLOCKS * BLOCKS)
    half_source = 0.5 * trials.images.shape[3] / views.per_mm - 1.0 / views.per_mm
    half = 0.5 * facets.pitch
    tile = np.zeros((count, channels, BLOCKS, BLOCKS), np.float32)
    seen, m = unknown_first_order(count), np.zeros(3)
    sighting = _Sighting(seen, np.zeros((count, 4)))
    centre = (facets.centres[f, 0], facets.centres[f, 1])
    facet = (centre[0], centre[1], facets.heights[f])
    if not _sight(views, facet, (0.0, 0.0), optics, True, seen):
        return
    _cut_tile(views, facets.pitch, seen, tile)
    lit = True
    for j in range(n):
        ry = (j - n // 2) * window.step
        for i in range(n):
            rx = (i - n // 2) * window.step
            if i % _REFRESH == 0:
                lit = _sight(views, facet, (rx, ry), optics, False, seen)
            else:  # a few steps along the derivative by the source point, whose change over them is tiny
                for v in range(count):
                    shift(seen, v, window.step)
            if not lit:
                continue
            kx = min(int((rx + window.half) / (2.0 * window.half) * window.buckets), window.buckets - 1)
            ky = min(int((ry + window.half) / (2.0 * window.half) * window.buckets), window.buckets - 1)
            k = ky * window.buckets + kx
            far = distance_term(rx, ry, window)
            for pair in range(len(trials.scales)):
                for sign in range(4 if trials.mirrored else 1):
                    m[0] = -trials.scales[pair, 0] if sign & 1 else trials.scales[pair, 0]
                    m[2] = -trials.scales[pair, 1] if sign & 2 else trials.scales[pair, 1]
                    if not _maps_on_source(sighting, m, half, half_source):
                        continue
                    limit = (found.errors[f, k] - far) / norm
                    total = _difference(tile, trials.images[pair], views, facets.pitch, seen, sighting.maps, limit)
                    if total < limit and reachable(centre, (rx, ry), (m[0], 0.0, m[2]), half, optics):
                        found.errors[f, k] = total * norm + far
                        found.offsets[f, k, 0], found.offsets[f, k, 1] = rx, ry
                        found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2] = m[0], 0.0, m[2]


@njit(cache=True, nogil=True)
def _search_views_part(part, views, facets, trials, window, optics, found):
    """Part of the facets, see ``search_views``."""
    for f in range(part.first, part.end):
        _search_facet(f, views, facets, trials, window, optics, found)


def search_views(views: Views, facets: Facets, trials: Trials, window: Window, optics: Optics, found: Found) -> None:
    """Try every offset and every map of the lattice for every facet; keep the best per bucket of the offset window.

    ``M = mean over views and blocks of (tile - patch)^2 + distance_term`` is minimised (4.2, 4.6).

    Args:
        views: ``Views`` with targets of N BLOCKS pixels.
        facets: where the facets are.
        trials: the maps that are tried.
        window: the search window.
        optics: ``Optics`` in the image frame.
        found: the best of each bucket so far, updated in place.
    """
    for block in resumable(blocks(len(facets.centres)), *found):
        in_threads(_search_views_part, block, views, facets, trials, window, optics, found)


@njit(cache=True)
def _look(views, facet, p, half_pitch, half_source, optics, sighting):
    """Fill what all eyes see of a candidate of parameters p; False if an eye misses the source."""
    for v in range(len(views.eyes)):
        if not linearise(views.eyes[v], facet, (p[0], p[1]), optics.eye, optics, True, sighting.seen, v):
            return False
        local_map(sighting.seen, v, p[2:], sighting.maps[v])
        if not _inside(sighting.seen, v, sighting.maps[v], half_pitch, half_source):
            return False
    return True


@njit(cache=True, fastmath=True)
def _normal_equations(views, levels, pitch, pixels, sighting, jtj, jtr, derive):
    """Mean squared difference of what all eyes see and their tiles; fills J^T J and J^T r too if ``derive``.

    See ``polishing_kernels._normal_equations``; a residual's slopes go through the derivative of an eye's landing point
    by the reference eye's source point, which the parameters move.
    """
    targets, which, per_mm, widths = views.targets, views.which, views.per_mm, levels.widths
    count, channels = targets.shape[0], targets.shape[1]
    px = pitch / pixels
    half = 0.5 * levels.images.shape[4] - 0.5
    target_per_mm = targets.shape[2] / views.size
    target_half = 0.5 * targets.shape[2] - 0.5
    j = np.zeros(PARAMETERS, np.float32)
    if derive:
        jtj[:] = 0.0
        jtr[:] = 0.0
    total = np.float32(0.0)
    for v in range(count):
        m, landing, by_source = sighting.maps[v], sighting.seen.landing[v], sighting.seen.by_source[v]
        position, spread = sighting.seen.position[v], sighting.seen.position_by_facet[v]
        footprint = px * math.sqrt(abs(m[0] * m[3] - m[1] * m[2]))
        level = 0
        while level + 1 < len(widths) and widths[level + 1] < PIXEL_WIDTHS * footprint:
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
                    value, gx, gy = bilinear(levels.images[level, which[v], c], x, y)
                    r = value - bilinear(targets[v, c], tx, ty)[0]
                    total += r * r
                    if derive:
                        hx = gx * by_source[0, 0] + gy * by_source[1, 0]
                        hy = gx * by_source[0, 1] + gy * by_source[1, 1]
                        j[0], j[1] = hx, hy
                        j[2], j[3], j[4] = hx * u, hx * w + hy * u, hy * w
                        for a in range(PARAMETERS):
                            jtr[a] += j[a] * r
                            for b in range(a + 1):
                                jtj[a, b] += j[a] * j[b]
    return total / (count * channels * pixels * pixels)


@njit(cache=True)
def _polish_facet(f, views, facets, polishing, window, optics, found):
    """Polish the candidates of facet f, see ``polish_views``; polishing: levels, pixels and rule."""
    levels, pixels, rule = polishing
    count, pitch, per_mm = len(views.eyes), facets.pitch, views.per_mm
    half_source = 0.5 * levels.images.shape[4] / per_mm
    jtj, jtr = np.zeros((PARAMETERS, PARAMETERS), np.float32), np.zeros(PARAMETERS, np.float32)
    room, step = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS)
    p, q = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    sighting = _Sighting(unknown_first_order(count), np.zeros((count, 4)))
    centre = (facets.centres[f, 0], facets.centres[f, 1])
    facet = (centre[0], centre[1], facets.heights[f])
    for k in range(found.errors.shape[1]):
        if not np.isfinite(found.errors[f, k]):
            continue
        read_candidate(found, f, k, p)
        if not _look(views, facet, p, 0.5 * pitch, half_source, optics, sighting):
            found.errors[f, k] = np.inf
            continue
        damping = 1e-2
        best = _normal_equations(views, levels, pitch, pixels, sighting, jtj, jtr, k < rule.most)
        for _ in range(rule.iterations if k < rule.most else 0):
            polishing_step(jtj, jtr, damping, per_mm, rule.isotropic, room, step)
            for a in range(PARAMETERS):
                q[a] = p[a] + step[a]
            trial = np.float32(np.inf)
            if (
                not (rule.isotropic and q[2] <= 0.0) and abs(q[0]) <= window.half and abs(q[1]) <= window.half
                and reachable(centre, (q[0], q[1]), (q[2], q[3], q[4]), 0.5 * pitch, optics)
                and _look(views, facet, q, 0.5 * pitch, half_source, optics, sighting)
            ):  # fmt: skip
                trial = _normal_equations(views, levels, pitch, pixels, sighting, jtj, jtr, False)
            if trial < best:
                gain = best - trial
                p, q = q, p
                damping *= 0.3
                best = _normal_equations(views, levels, pitch, pixels, sighting, jtj, jtr, True)
                if gain < 1e-3 * best:
                    break
            else:
                damping *= 6.0
                if damping > 1e4:
                    break
        found.errors[f, k] = best + distance_term(p[0], p[1], window)
        write_candidate(p, found, f, k)


@njit(cache=True, nogil=True)
def _polish_views_part(part, views, facets, polishing, window, optics, found):
    """Part of the facets, see ``polish_views``."""
    for f in range(part.first, part.end):
        _polish_facet(f, views, facets, polishing, window, optics, found)


def polish_views(
    views: Views,
    facets: Facets,
    levels: Levels,
    pixels: int,
    window: Window,
    rule: PolishingRule,
    optics: Optics,
    found: Found,
) -> None:
    """Polish candidates in place by Levenberg-Marquardt, on what all eyes see; all get their new error.

    ``mean over views and pixels of (tile - patch)^2`` is minimised.

    Args:
        views: ``Views`` whose targets have any number of pixels.
        facets: where the facets are.
        levels: ``Levels`` (L, S, C, H, W) of the sources.
        pixels: along a tile's side, at which pictures are compared.
        window: the search window, which candidates do not leave.
        rule: how many are polished, and how.
        optics: ``Optics`` in the image frame.
        found: the candidates, updated in place.
    """
    polishing = (levels, pixels, rule)
    for block in resumable(blocks(len(facets.centres)), *found):
        in_threads(_polish_views_part, block, views, facets, polishing, window, optics, found)


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _evaluate_facet(f, views, facets, shown, window, optics, found):
    """Replace the errors of the candidates of facet f, see ``evaluate_views``; shown: sources, pixels and stairs."""
    sources, pixels, stairs = shown
    targets, per_mm, pitch, table = views.targets, views.per_mm, facets.pitch, stairs.display
    count, channels = targets.shape[0], targets.shape[1]
    side = sources.shape[3]
    half = 0.5 * side - 0.5
    target_per_mm = targets.shape[2] / views.size
    target_half = 0.5 * targets.shape[2] - 0.5
    scale = (len(table) - 1) / (LOOK_UPS * LOOK_UPS)
    cell, sub, px = pitch / stairs.microfacets, pitch / (pixels * LOOK_UPS), pitch / pixels
    sighting = _Sighting(unknown_first_order(count), np.zeros((count, 4)))
    light, p = np.zeros(channels, np.float32), np.zeros(PARAMETERS)
    for k in range(found.errors.shape[1]):
        if not np.isfinite(found.errors[f, k]):
            continue
        read_candidate(found, f, k, p)
        facet = (facets.centres[f, 0], facets.centres[f, 1], facets.heights[f])
        if not _look(views, facet, p, 0.5 * pitch, np.inf, optics, sighting):
            found.errors[f, k] = np.inf
            continue
        total = 0.0
        for v in range(count):
            m, source = sighting.maps[v], sources[views.which[v]]
            landing, flat = sighting.seen.landing[v], sighting.seen.flat_by_facet[v]
            position, spread = sighting.seen.position[v], sighting.seen.position_by_facet[v]
            for pixel in range(pixels * pixels):
                light[:] = 0.0
                for n in range(LOOK_UPS * LOOK_UPS):
                    u = ((pixel % pixels) * LOOK_UPS + n % LOOK_UPS + 0.5) * sub
                    w = ((pixel // pixels) * LOOK_UPS + n // LOOK_UPS + 0.5) * sub
                    a, b = (math.floor(u / cell) + 0.5) * cell, (math.floor(w / cell) + 0.5) * cell
                    du, dw = u - a, w - b
                    a, b = a - 0.5 * pitch, b - 0.5 * pitch
                    x = landing[0] + m[0] * a + m[1] * b + flat[0, 0] * du + flat[0, 1] * dw
                    y = landing[1] + m[2] * a + m[3] * b + flat[1, 0] * du + flat[1, 1] * dw
                    x, y = x * per_mm + half, y * per_mm + half
                    if abs(x - half) > half + 0.5 or abs(y - half) > half + 0.5:
                        continue  # beside the source it is dark
                    ix, iy, dx, dy = clamped_cell(x, y, side, side)
                    fx, fy = np.float32(dx), np.float32(dy)
                    for c in range(channels):
                        light[c] += blend(source[c, iy, ix : ix + 2], source[c, iy + 1, ix : ix + 2], fx, fy)
                u, w = (pixel % pixels + 0.5) * px - 0.5 * pitch, (pixel // pixels + 0.5) * px - 0.5 * pitch
                tx = (position[0] + spread[0, 0] * u + spread[0, 1] * w) * target_per_mm + target_half
                ty = (position[1] + spread[1, 0] * u + spread[1, 1] * w) * target_per_mm + target_half
                for c in range(channels):
                    d = table[int(light[c] * scale + 0.5)] - bilinear(targets[v, c], tx, ty)[0]
                    total += d * d
        far = distance_term(found.offsets[f, k, 0], found.offsets[f, k, 1], window)
        found.errors[f, k] = total / (count * channels * pixels * pixels) + far


@njit(cache=True, nogil=True)
def _evaluate_views_part(part, views, facets, shown, window, optics, found):
    """Part of the facets, see ``evaluate_views``."""
    for f in range(part.first, part.end):
        _evaluate_facet(f, views, facets, shown, window, optics, found)


def evaluate_views(
    views: Views,
    facets: Facets,
    sources: FloatArray,
    pixels: int,
    stairs: Staircase,
    window: Window,
    optics: Optics,
    found: Found,
) -> None:
    """Replace candidates' errors by what flat micro-facets show all eyes; see ``evaluation_kernels.evaluate``.

    ``error = mean over views and pixels of (display(mean light of the look-ups) - tile)^2 + distance_term``, a look-up
    at p in the micro-facet centred at a being ``landing + M a + flat_by_facet (p - a)``.

    Args:
        views: ``Views`` whose targets have any number of pixels.
        facets: where the facets are.
        sources: (S, C, H, W) float32, linear light.
        pixels: along a tile's side.
        stairs: how flat micro-facets show the source.
        window: the search window.
        optics: ``Optics`` in the image frame.
        found: the candidates; their errors are updated in place.
    """
    shown = (sources, pixels, stairs)
    for block in resumable(blocks(len(facets.centres)), *found):
        in_threads(_evaluate_views_part, block, views, facets, shown, window, optics, found)
