"""Kernels of texture synthesis: tiles of an example laid side by side, and pixels' origins improved one by one.

Pictures are rows (H, W * C) of display values, channels interleaved, so that a row of a patch is contiguous.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit

REACH = 3
"""Pixels to each side in which the surroundings of two pixels are compared."""
_TILE_TRIES = 1500
"""Random tiles of the example that are tried for each tile of the picture."""
_RANDOM_TRIES = 2
"""Random origins that are tried for each pixel, the second one nearer to its present origin."""
_INFINITE = np.float32(3e38)
"""A cost that no patch reaches."""


class Canvas(NamedTuple):
    """An example, and the picture that is made of it.

    example: (h, w * C) float32, display values. picture: (H, W * C) float32, display values, changed by the kernels.
    weights: (H, W * C) float32, weights of the picture's values in comparisons, 0 where there is nothing yet.
    channels: C, 1 or 3.
    """

    example: FloatArray
    picture: FloatArray
    weights: FloatArray
    channels: int


# fastmath lets the compiler reorder this sum and use vector instructions
@njit(cache=True, fastmath=True)
def _difference(canvas, from_y, from_x, y, x, side, limit):
    """Sum of ``weight * (picture - example)^2`` over two square patches; stops at the first row that passes the limit.

    The example's patch has its top left pixel at row from_y and column from_x, the picture's at row y and column x.
    """
    total = np.float32(0.0)
    run = side * canvas.channels
    for k in range(side):
        ours = canvas.picture[y + k, x * canvas.channels : x * canvas.channels + run]
        weight = canvas.weights[y + k, x * canvas.channels : x * canvas.channels + run]
        theirs = canvas.example[from_y + k, from_x * canvas.channels : from_x * canvas.channels + run]
        for n in range(run):
            d = ours[n] - theirs[n]
            total += weight[n] * d * d
        if total >= limit:
            break
    return total


@njit(cache=True)
def lay_tiles(canvas, tile, starts_y, starts_x, reuse_cost, origins, rng):
    """Lay tiles of the example over the picture, each the cheapest of many random ones.

    A tile costs its mean difference from what is known or laid already, weighted, plus
    ``reuse_cost * (uses of this part of the example) / (mean uses + 1)``.

    Args:
        canvas: Its picture and weights are changed where nothing was known or laid.
        tile: Side of a tile, pixels.
        starts_y: First rows of the tiles.
        starts_x: First columns of the tiles.
        reuse_cost: Cost of a part that is used once more than others, as a squared difference of display values.
        origins: (H, W, 2) row and column in the example of each pixel, -1 before it is laid; changed in place.
        rng: Randomness.
    """
    channels, weights = canvas.channels, canvas.weights
    reach_y, reach_x = len(canvas.example) - tile + 1, canvas.example.shape[1] // channels - tile + 1
    uses = np.zeros((reach_y, reach_x), np.float32)
    laid = 0
    for y in starts_y:
        for x in starts_x:
            scale = max(weights[y : y + tile, x * channels : (x + tile) * channels].sum(), np.float32(1.0))
            mean = laid * tile * tile / (reach_y * reach_x)
            best, from_y, from_x = _INFINITE, 0, 0
            for _ in range(_TILE_TRIES):
                ty, tx = int(rng.random() * reach_y), int(rng.random() * reach_x)
                reuse = np.float32(reuse_cost * uses[ty, tx] / (mean + 1.0))
                if reuse < best:
                    limit = (best - reuse) * scale
                    cost = reuse + _difference(canvas, ty, tx, y, x, tile, limit) / scale
                    if cost < best:
                        best, from_y, from_x = cost, ty, tx
            _count_use(uses, from_y, from_x, tile)
            _lay_tile(canvas, from_y, from_x, y, x, tile, origins)
            laid += 1


@njit(cache=True)
def _count_use(uses, from_y, from_x, tile):
    """Add to every tile of the example the share of it that the tile at (from_y, from_x) covers."""
    for y in range(max(from_y - tile + 1, 0), min(from_y + tile, len(uses))):
        for x in range(max(from_x - tile + 1, 0), min(from_x + tile, uses.shape[1])):
            uses[y, x] += (1.0 - abs(y - from_y) / tile) * (1.0 - abs(x - from_x) / tile)


@njit(cache=True)
def _lay_tile(canvas, from_y, from_x, y, x, tile, origins):
    """Copy a tile's pixels to where there is nothing yet; set the origins of known pixels, too."""
    for dy in range(tile):
        for dx in range(tile):
            if origins[y + dy, x + dx, 0] >= 0:
                continue
            origins[y + dy, x + dx, 0], origins[y + dy, x + dx, 1] = from_y + dy, from_x + dx
            for c in range(canvas.channels):
                n = (x + dx) * canvas.channels + c
                if canvas.weights[y + dy, n] == 0:
                    canvas.weights[y + dy, n] = 1
                    canvas.picture[y + dy, n] = canvas.example[from_y + dy, (from_x + dx) * canvas.channels + c]


@njit(cache=True)
def improve_origins(canvas, near, known, backward, origins, rng):
    """One pass of PatchMatch: every pixel takes the origin whose patch differs least from the pixel's own patch.

    Tried are the present origin, the continuations of the eight neighbours' origins, and a few random ones. Patches
    reach ``REACH`` pixels to each side, so the top left pixel of the patch around an origin lies ``REACH`` up and left
    of it; in the padded picture the top left pixel of a pixel's patch has the pixel's own row and column.

    Args:
        canvas: Its picture and weights are padded by ``REACH``; the picture's unknown pixels are changed.
        near: (H, W) bool, pixels that are looked at: those whose patches hold unknown pixels.
        known: (H, W) bool, pixels that keep their values.
        backward: Whether the pass runs from the last pixel to the first.
        origins: (H, W, 2) row and column in the example of each pixel; changed in place.
        rng: Randomness.
    """
    height, width = near.shape
    channels, side = canvas.channels, 2 * REACH + 1
    last_y, last_x = len(canvas.example) - side, canvas.example.shape[1] // channels - side
    for k in range(height * width):
        n = height * width - 1 - k if backward else k
        y, x = n // width, n % width
        if not near[y, x]:
            continue
        was_y, was_x = origins[y, x, 0] - REACH, origins[y, x, 1] - REACH
        best = _difference(canvas, was_y, was_x, y, x, side, _INFINITE)
        from_y, from_x = was_y, was_x
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if not (0 <= y + dy < height and 0 <= x + dx < width):
                    continue
                ty, tx = origins[y + dy, x + dx, 0] - REACH - dy, origins[y + dy, x + dx, 1] - REACH - dx
                tried = (ty == from_y and tx == from_x) or (ty == was_y and tx == was_x)
                if tried or not (0 <= ty <= last_y and 0 <= tx <= last_x):
                    continue
                cost = _difference(canvas, ty, tx, y, x, side, best)
                if cost < best:
                    best, from_y, from_x = cost, ty, tx
        reach = max(last_y, last_x)
        for _ in range(_RANDOM_TRIES):
            ty = min(max(from_y + int((2.0 * rng.random() - 1.0) * reach), 0), last_y)
            tx = min(max(from_x + int((2.0 * rng.random() - 1.0) * reach), 0), last_x)
            cost = _difference(canvas, ty, tx, y, x, side, best)
            if cost < best:
                best, from_y, from_x = cost, ty, tx
            reach //= 2
        if from_y != was_y or from_x != was_x:
            origins[y, x, 0], origins[y, x, 1] = from_y + REACH, from_x + REACH
            if not known[y, x]:
                for c in range(channels):
                    origin = (from_x + REACH) * channels + c
                    canvas.picture[y + REACH, (x + REACH) * channels + c] = canvas.example[from_y + REACH, origin]
