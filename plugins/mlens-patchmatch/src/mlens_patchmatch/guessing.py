"""The search: random patches, neighbours' patches, patches near good ones (Barnes et al. 2009).

``world`` is what stays the same: tiles (F, P^2, C) display values; levels (L, H, H, C) display values of the source,
averaged over boxes; widths (L,) of these, mm; source pixels per mm; a tile's pixel, mm; half the window, mm; the order
in which pixels are compared (P^2,); centres (F, 2), mm; reach (F, R, R) bool, see ``search``. A place is (offset x, y,
map xx, yy); each part of a facet's window has one, and its error.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

PIXELS = 8
"""Per side of a tile."""


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
def _difference(tile, levels, widths, per_mm, px, order, cx, cy, rx, ry, sx, sy, limit):
    """Mean squared difference of a tile (P^2, C) and a patch; stops once above the limit, inf outside the source."""
    seen, level = px * math.sqrt(abs(sx * sy)), 0
    while level + 1 < len(widths) and widths[level + 1] < 1.4 * seen:
        level += 1
    image = levels[level]
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
def _try(world, f, rx, ry, sx, sy, errors, places):
    """Keep a patch if it is better than what its part of the window has."""
    tiles, levels, widths, per_mm, px, window, order, centres, reach = world
    k = _cell(rx, ry, window, int(math.sqrt(errors.shape[1]) + 0.5))
    if k < 0:
        return
    cells = reach.shape[1]
    at = _cell(rx, ry, window, cells)
    if not reach[f, at // cells, at % cells]:
        return
    cx, cy = centres[f, 0], centres[f, 1]
    error = _difference(tiles[f], levels, widths, per_mm, px, order, cx, cy, rx, ry, sx, sy, errors[f, k])
    if error < errors[f, k]:
        errors[f, k] = error
        places[f, k, 0], places[f, k, 1], places[f, k, 2], places[f, k, 3] = rx, ry, sx, sy


@njit(cache=True)
def _magnitude(seeds, f, low, high):
    """A map's entry: log-uniform between the limits, of either sign."""
    size = math.exp(low + (high - low) * _random(seeds, f))
    return size if _random(seeds, f) < 0.5 else -size


@njit(cache=True, parallel=True)
def guess(world, low, high, guesses, seeds, errors, places):
    """Random patches in every part of every facet's window; their maps' logarithms lie between low and high."""
    window, parts = world[5], int(math.sqrt(errors.shape[1]) + 0.5)
    size = 2 * window / parts
    for f in prange(len(errors)):
        for k in range(parts * parts):
            left, top = (k % parts) * size - window, (k // parts) * size - window
            for _ in range(guesses):
                rx, ry = left + size * _random(seeds, f), top + size * _random(seeds, f)
                sx, sy = _magnitude(seeds, f, low, high), _magnitude(seeds, f, low, high)
                _try(world, f, rx, ry, sx, sy, errors, places)


@njit(cache=True, parallel=True)
def improve(world, low, high, n, seeds, before, known, errors, places):
    """Try neighbours' patches, then search around the best of each part of the window.

    before, known: errors and places as they were, so that the order of facets does not matter.
    """
    for f in prange(len(errors)):
        _ask_neighbours(world, f, n, before, known, errors, places)
        for k in range(errors.shape[1]):
            if np.isfinite(errors[f, k]):
                _search_around(world, f, k, low, high, seeds, errors, places)


@njit(cache=True)
def _ask_neighbours(world, f, n, before, known, errors, places):
    """Try neighbours' patches at the same offset, and where they go on beyond the neighbour's edge."""
    pitch = PIXELS * world[4]
    i, j = f // n, f % n
    for side in range(4):
        r, c = i + (side == 0) - (side == 1), j + (side == 2) - (side == 3)
        if not (0 <= r < n and 0 <= c < n):
            continue
        for k in range(errors.shape[1]):
            rx, ry, sx, sy = known[r * n + c, k]
            if before[r * n + c, k] <= errors[f, k] and sx != 0.0:
                _try(world, f, rx, ry, sx, sy, errors, places)
                on_x, on_y = (sx - 1) * (j - c) * pitch, (sy - 1) * (i - r) * pitch
                _try(world, f, rx + on_x, ry + on_y, sx, sy, errors, places)


@njit(cache=True)
def _search_around(world, f, k, low, high, seeds, errors, places):
    """Try other offsets and maps, ever closer to the best one, down to half a pixel of the source."""
    per_mm, pitch, window = world[3], PIXELS * world[4], world[5]
    radius = window / math.sqrt(errors.shape[1])
    while radius > 0.5 / per_mm:
        near = min(radius / pitch, 1.0)
        rx = places[f, k, 0] + radius * (2 * _random(seeds, f) - 1)
        ry = places[f, k, 1] + radius * (2 * _random(seeds, f) - 1)
        sx = places[f, k, 2] * math.exp(near * (2 * _random(seeds, f) - 1))
        sy = places[f, k, 3] * math.exp(near * (2 * _random(seeds, f) - 1))
        if low <= math.log(abs(sx)) <= high and low <= math.log(abs(sy)) <= high:
            _try(world, f, rx, ry, sx, sy, errors, places)
        radius *= 0.5
