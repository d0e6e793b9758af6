"""Kernels of the search: random patches, neighbours' patches, patches near good ones (Barnes et al. 2009).

A patch is (offset x, y in mm, y down; map xx, yy). Each part of a facet's window keeps one patch and its error.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from magiclens import FloatArray, IntArray

PIXELS = 8
"""Pixels per side of a tile."""


class World(NamedTuple):
    """What stays the same during a search.

    Args:
        tiles: (F, PIXELS^2, C) float32 display values.
        centres: (F, 2) of the facets, mm, y down.
        reach: (F, R, R) bool: whether a facet can show what lies in a cell of its window.
        levels: (L, H, H, C) float32 display values of the source, averaged over boxes.
        widths: (L,) side of these boxes, mm.
        per_mm: source pixels per mm.
        px: side of a tile's pixel, mm.
        half_window: half the side of the window, mm.
        order: (PIXELS^2,) in which pixels are compared.
        low: natural logarithm of the smallest magnitude of a map.
        high: natural logarithm of the largest.
    """

    tiles: FloatArray
    centres: FloatArray
    reach: NDArray[np.bool_]
    levels: FloatArray
    widths: FloatArray
    per_mm: float
    px: float
    half_window: float
    order: IntArray
    low: float
    high: float


@njit(cache=True)
def _random(seeds, f):
    """A number from 0 to 1 of facet f's own sequence (xorshift, Marsaglia 2003)."""
    x = seeds[f]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    seeds[f] = x
    return (x >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _difference(world, f, patch, limit):
    """Mean squared difference of facet f's tile and a patch; inf above the limit or outside the source.

    The difference is ``sum over pixels and channels of (source(c + R + M u) - tile(u))^2`` over their number.
    """
    rx, ry, sx, sy = patch
    tile, widths, per_mm, px, order = world.tiles[f], world.widths, world.per_mm, world.px, world.order
    cx, cy = world.centres[f, 0], world.centres[f, 1]
    seen, level = px * math.sqrt(abs(sx * sy)), 0
    while level + 1 < len(widths) and widths[level + 1] < 1.4 * seen:
        level += 1
    image = world.levels[level]
    size = len(image)
    half = 0.5 * PIXELS * px
    middle = 0.5 * size
    x0, y0 = (cx + rx) * per_mm + middle, (cy + ry) * per_mm + middle
    if min(x0, size - x0) < abs(sx) * half * per_mm or min(y0, size - y0) < abs(sy) * half * per_mm:
        return np.float32(np.inf)
    dx, dy = sx * px * per_mm, sy * px * per_mm
    channels = tile.shape[1]
    stop, total = limit * len(order) * channels, np.float32(0.0)
    for k in order:
        column = min(max(int(x0 + ((k % PIXELS) - 0.5 * (PIXELS - 1)) * dx), 0), size - 1)
        row = min(max(int(y0 + ((k // PIXELS) - 0.5 * (PIXELS - 1)) * dy), 0), size - 1)
        for c in range(channels):
            d = image[row, column, c] - tile[k, c]
            total += d * d
        if total >= stop:
            return np.float32(np.inf)
    return total / np.float32(len(order) * channels)


@njit(cache=True)
def _cell(rx, ry, window, cells):
    """Which of cells x cells parts of the window an offset lies in; -1 outside."""
    if abs(rx) > window or abs(ry) > window:
        return -1
    column = min(int((rx + window) / (2 * window) * cells), cells - 1)
    return min(int((ry + window) / (2 * window) * cells), cells - 1) * cells + column


@njit(cache=True)
def _try(world, f, patch, errors, patches):
    """Keep a patch if it is better than what its part of the window has."""
    rx, ry, sx, sy = patch
    k = _cell(rx, ry, world.half_window, int(math.sqrt(errors.shape[1]) + 0.5))
    if k < 0:
        return
    cells = world.reach.shape[1]
    at = _cell(rx, ry, world.half_window, cells)
    if not world.reach[f, at // cells, at % cells]:
        return
    error = _difference(world, f, patch, errors[f, k])
    if error < errors[f, k]:
        errors[f, k] = error
        patches[f, k, 0], patches[f, k, 1], patches[f, k, 2], patches[f, k, 3] = rx, ry, sx, sy


@njit(cache=True)
def _magnitude(world, f, seeds):
    """A map's entry: log-uniform between the limits, of either sign."""
    size = math.exp(world.low + (world.high - world.low) * _random(seeds, f))
    return size if _random(seeds, f) < 0.5 else -size


@njit(cache=True, parallel=True)
def guess(world, guesses, seeds, errors, patches):
    """Try random patches in every part of every facet's window.

    Args:
        world: what stays the same.
        guesses: per part of a window.
        seeds: (F,) uint64, state of each facet's random numbers, updated in place.
        errors: (F, K) float32 of the best patches, updated in place.
        patches: (F, K, 4) float32, updated in place.
    """
    parts = int(math.sqrt(errors.shape[1]) + 0.5)
    window = world.half_window
    size = 2 * window / parts
    for f in prange(len(errors)):
        for k in range(parts * parts):
            left, top = (k % parts) * size - window, (k // parts) * size - window
            for _ in range(guesses):
                rx, ry = left + size * _random(seeds, f), top + size * _random(seeds, f)
                sx, sy = _magnitude(world, f, seeds), _magnitude(world, f, seeds)
                _try(world, f, (rx, ry, sx, sy), errors, patches)


@njit(cache=True, parallel=True)
def improve(world, n, seeds, before, known, errors, patches):
    """Try neighbours' patches, then search around the best of each part of the window.

    Args:
        world: what stays the same.
        n: facets along the lens's side.
        seeds: (F,) uint64, state of each facet's random numbers, updated in place.
        before: the errors as they were, so that the order of facets does not matter.
        known: the patches as they were.
        errors: (F, K) float32 of the best patches, updated in place.
        patches: (F, K, 4) float32, updated in place.
    """
    for f in prange(len(errors)):
        _ask_neighbours(world, f, n, before, known, errors, patches)
        for k in range(errors.shape[1]):
            if np.isfinite(errors[f, k]):
                _search_around(world, f, k, seeds, errors, patches)


@njit(cache=True)
def _ask_neighbours(world, f, n, before, known, errors, patches):
    """Try neighbours' patches at the same offset, and where they go on beyond the neighbour's edge."""
    pitch = PIXELS * world.px
    i, j = f // n, f % n
    for side in range(4):
        r, c = i + (side == 0) - (side == 1), j + (side == 2) - (side == 3)
        if not (0 <= r < n and 0 <= c < n):
            continue
        for k in range(errors.shape[1]):
            rx, ry, sx, sy = known[r * n + c, k]
            if before[r * n + c, k] <= errors[f, k] and sx != 0.0:
                _try(world, f, (rx, ry, sx, sy), errors, patches)
                on_x, on_y = (sx - 1) * (j - c) * pitch, (sy - 1) * (i - r) * pitch
                _try(world, f, (rx + on_x, ry + on_y, sx, sy), errors, patches)


@njit(cache=True)
def _search_around(world, f, k, seeds, errors, patches):
    """Try other offsets and maps, ever closer to the best one, down to half a pixel of the source."""
    pitch = PIXELS * world.px
    radius = world.half_window / math.sqrt(errors.shape[1])
    while radius > 0.5 / world.per_mm:
        near = min(radius / pitch, 1.0)
        rx = patches[f, k, 0] + radius * (2 * _random(seeds, f) - 1)
        ry = patches[f, k, 1] + radius * (2 * _random(seeds, f) - 1)
        sx = patches[f, k, 2] * math.exp(near * (2 * _random(seeds, f) - 1))
        sy = patches[f, k, 3] * math.exp(near * (2 * _random(seeds, f) - 1))
        if world.low <= math.log(abs(sx)) <= world.high and world.low <= math.log(abs(sy)) <= world.high:
            _try(world, f, (rx, ry, sx, sy), errors, patches)
        radius *= 0.5
