"""Patch-based texture synthesis around known pixels (paper section 5.2).

Every unknown pixel is a copy of one pixel of the example, its *place*. At the coarsest size tiles of the example
are laid one after the other, each the one of many random ones that fits best what lies there already: known pixels
and earlier tiles. Then, from coarse to fine, each pixel looks for the place whose surroundings match its own best,
among the continuations of its neighbours' places and a few random ones (as in PatchMatch). Tiles so grow into one
another along seams that do not show, and toward known pixels.

Kernels hold pictures as rows (H, W * C) of display values, channels interleaved, so that a patch's row is one run.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from magiclens.contract.errors import InputError
from magiclens.images.colour import FloatArray, to_display
from magiclens.images.inpaint import BoolArray, halved

IntArray = NDArray[np.signedinteger]

FINE_PX = 1024
"""Pictures from here on are matched at half the resolution."""
LEAST_EXAMPLE_PX = 16
COARSE_TILE_PX = 12
"""Tiles are laid at the coarsest size, halving, at which they still have this many pixels per side."""
OVERLAP = 4
"""Neighbouring tiles share one part in this many."""
TILE_TRIES = 1500
REUSE_COST = 0.5
"""Cost of laying a part of the example once more than others are laid on average, in variances of the example."""
REACH = 3
"""Pixels to each side in which the surroundings of two pixels are compared."""
RANDOM_TRIES = 2
KNOWN_WEIGHT = 10.0
"""Weight of known pixels when surroundings are compared; others weigh 1."""
ENDLESS = np.float32(3e38)


def synthesize(
    example: FloatArray, fixed: FloatArray, known: BoolArray, rng: np.random.Generator, patch_px: int = 48
) -> FloatArray:
    """(H, W, C) float32, linear light: ``fixed`` with unknown pixels filled by the texture of ``example`` (h, w, C).

    ``known`` is (H, W); known pixels come back unchanged, what unknown ones hold is ignored. ``patch_px`` is the side
    of the tiles, at least as large as the texture's features; small examples and pictures take smaller ones. Raises
    InputError if the example is smaller than 16 x 16 pixels.
    """
    rows, columns, channels = example.shape
    if min(rows, columns) < LEAST_EXAMPLE_PX:
        least = f"{LEAST_EXAMPLE_PX} x {LEAST_EXAMPLE_PX}"
        raise InputError(f"the example of a texture is {columns} x {rows} pixels; it needs at least {least}")
    if fixed.shape != (*known.shape, channels):
        raise ValueError(f"the picture has shape {fixed.shape}, not {(*known.shape, channels)}")
    even = known.shape[0] % 2 == known.shape[1] % 2 == 0
    if even and min(known.shape) >= FINE_PX and min(rows, columns) >= 8 * LEAST_EXAMPLE_PX:
        places = _fine_places(example[: rows // 2 * 2, : columns // 2 * 2], fixed, known, rng, patch_px // 2)
    else:
        tile = min(patch_px, rows // 2, columns // 2, *known.shape)
        places = _places(example, np.where(known[..., None], fixed, 0), known, rng, tile)
    copied = example[places[..., 0], places[..., 1]]
    return np.where(known[..., None], fixed, copied).astype(np.float32)


def _fine_places(
    example: FloatArray, fixed: FloatArray, known: BoolArray, rng: np.random.Generator, tile: int
) -> IntArray:
    """As of ``_places``, found at half the resolution: blocks of 2 x 2 pixels are copied whole, four times as fast."""
    small, whole = halved(example), halved(known[..., None].astype(np.float32))[..., 0] == 1
    around = halved(np.where(known[..., None], fixed, 0).astype(np.float32))
    coarse = _places(small, np.where(whole[..., None], around, 0), whole, rng, max(tile, 4))
    places = 2 * coarse.repeat(2, axis=0).repeat(2, axis=1)
    places[1::2, :, 0] += 1
    places[:, 1::2, 1] += 1
    return places


def _places(example: FloatArray, fixed: FloatArray, known: BoolArray, rng: np.random.Generator, tile: int) -> IntArray:
    """(H, W, 2) row and column in the example of every pixel; only those of unknown pixels mean much."""
    halvings = max(int(np.log2(tile / COARSE_TILE_PX)), 0)
    examples = _pyramid(to_display(example).astype(np.float32), halvings)
    colours = _pyramid(to_display(fixed).astype(np.float32), halvings)
    shares = _pyramid(known.astype(np.float32), halvings)
    places = np.zeros((0, 0, 2), np.int32)
    for level in reversed(range(halvings + 1)):
        pattern, share = examples[level], shares[level]
        picture = colours[level] / np.where(share > 0, share, 1)[..., None]
        weight = np.where(share >= 0.5, np.float32(KNOWN_WEIGHT), np.float32(0))
        if level == halvings:
            places = _tiled(pattern, picture, weight, tile >> level, rng)
        else:
            places = _doubled(places, share.shape)
        places = _refined(pattern, picture, weight, places, 2 + min(level, 2), rng)
    return places


def _pyramid(image: FloatArray, halvings: int) -> list[FloatArray]:
    """The image and its halves, finest first."""
    images = [image]
    for _ in range(halvings):
        images.append(halved(images[-1]))
    return images


def _tiled(
    pattern: FloatArray, picture: FloatArray, weight: FloatArray, tile: int, rng: np.random.Generator
) -> IntArray:
    """(H, W, 2) places of tiles laid in reading order; ``weight`` (H, W) is 0 where nothing is known."""
    channels = pattern.shape[-1]
    rows, weights = _rows(picture), _rows(np.repeat(weight[..., None], channels, axis=-1))
    starts_y, starts_x = (_starts(length, tile) for length in weight.shape)
    places = np.full((*weight.shape, 2), -1, np.int32)
    reuse_cost = REUSE_COST * float(pattern.var())
    _lay_tiles(_rows(pattern), rows, weights, channels, tile, starts_y, starts_x, reuse_cost, places, rng)
    return places


def _starts(length: int, tile: int) -> IntArray:
    """First pixels of overlapping tiles that cover a side."""
    step = tile - tile // OVERLAP
    return np.append(np.arange(0, length - tile, step), length - tile)


def _doubled(places: IntArray, shape: tuple[int, ...]) -> IntArray:
    """The places (H, W, 2) at twice the size, cut to ``shape``."""
    rows, columns = np.arange(shape[0])[:, None], np.arange(shape[1])[None, :]
    odd = np.stack(np.broadcast_arrays(rows % 2, columns % 2), axis=-1)
    return np.asarray(2 * places[rows // 2, columns // 2] + odd)


def _refined(
    pattern: FloatArray,
    picture: FloatArray,
    weight: FloatArray,
    places: IntArray,
    passes: int,
    rng: np.random.Generator,
) -> IntArray:
    """Better places (H, W, 2) after a few passes over the pixels, to and fro."""
    from scipy.ndimage import maximum_filter

    height, width, channels = pattern.shape
    places = np.clip(places, REACH, (height - 1 - REACH, width - 1 - REACH)).astype(np.int32)
    known = weight > 0
    near = maximum_filter(~known, 2 * REACH + 1)
    start = np.where(known[..., None], picture, pattern[places[..., 0], places[..., 1]])
    around = ((REACH, REACH), (REACH, REACH), (0, 0))
    weights = np.pad(np.repeat(np.maximum(weight, 1)[..., None], channels, axis=-1), around)
    rows = _rows(np.pad(start, around))
    for k in range(passes):
        _improve(_rows(pattern), rows, _rows(weights), channels, near, known, k % 2 == 1, places, rng)
    return places


def _rows(image: FloatArray) -> FloatArray:
    """(H, W * C) of an (H, W, C) image."""
    return np.ascontiguousarray(image, np.float32).reshape(len(image), -1)


@njit(cache=True, fastmath=True)
def _difference(pattern, at_y, at_x, rows, weights, y, x, side, channels, limit):
    """Weighted sum of squared differences of two patches, given by their top left pixels; stops above the limit."""
    total = np.float32(0.0)
    run = side * channels
    for k in range(side):
        ours = rows[y + k, x * channels : x * channels + run]
        weight = weights[y + k, x * channels : x * channels + run]
        theirs = pattern[at_y + k, at_x * channels : at_x * channels + run]
        for n in range(run):
            d = ours[n] - theirs[n]
            total += weight[n] * d * d
        if total >= limit:
            break
    return total


@njit(cache=True)
def _lay_tiles(pattern, rows, weights, channels, tile, starts_y, starts_x, reuse_cost, places, rng):
    """Lay tiles where nothing is known or laid yet; ``rows``, ``weights`` and ``places`` are updated in place."""
    reach_y, reach_x = len(pattern) - tile + 1, pattern.shape[1] // channels - tile + 1
    uses = np.zeros((reach_y, reach_x), np.float32)
    laid = 0
    for y in starts_y:
        for x in starts_x:
            scale = max(weights[y : y + tile, x * channels : (x + tile) * channels].sum(), np.float32(1.0))
            mean = laid * tile * tile / (reach_y * reach_x)
            best, at_y, at_x = ENDLESS, 0, 0
            for _ in range(TILE_TRIES):
                ty, tx = int(rng.random() * reach_y), int(rng.random() * reach_x)
                reuse = np.float32(reuse_cost * uses[ty, tx] / (mean + 1.0))
                if reuse < best:
                    limit = (best - reuse) * scale
                    cost = reuse + _difference(pattern, ty, tx, rows, weights, y, x, tile, channels, limit) / scale
                    if cost < best:
                        best, at_y, at_x = cost, ty, tx
            _count(uses, at_y, at_x, tile)
            _lay(pattern, at_y, at_x, rows, weights, y, x, tile, channels, places)
            laid += 1


@njit(cache=True)
def _count(uses, at_y, at_x, tile):
    """Add to every tile of the example the share of it that the tile at (at_y, at_x) covers."""
    for y in range(max(at_y - tile + 1, 0), min(at_y + tile, len(uses))):
        for x in range(max(at_x - tile + 1, 0), min(at_x + tile, uses.shape[1])):
            uses[y, x] += (1.0 - abs(y - at_y) / tile) * (1.0 - abs(x - at_x) / tile)


@njit(cache=True)
def _lay(pattern, at_y, at_x, rows, weights, y, x, tile, channels, places):
    """Copy a tile's pixels to where nothing is, and its places also under known pixels."""
    for dy in range(tile):
        for dx in range(tile):
            if places[y + dy, x + dx, 0] >= 0:
                continue
            places[y + dy, x + dx, 0], places[y + dy, x + dx, 1] = at_y + dy, at_x + dx
            for c in range(channels):
                n = (x + dx) * channels + c
                if weights[y + dy, n] == 0:
                    weights[y + dy, n] = 1
                    rows[y + dy, n] = pattern[at_y + dy, (at_x + dx) * channels + c]


@njit(cache=True)
def _improve(pattern, rows, weights, channels, near, known, backward, places, rng):
    """One pass over the pixels ``near`` unknown ones; ``rows`` (padded by REACH) and ``places`` change in place.

    A place is compared by the patch around it, so patches' top left pixels lie REACH up and left of it; in the
    padded picture that is the pixel's own row and column.
    """
    height, width = near.shape
    side = 2 * REACH + 1
    last_y, last_x = len(pattern) - side, pattern.shape[1] // channels - side
    for k in range(height * width):
        n = height * width - 1 - k if backward else k
        y, x = n // width, n % width
        if not near[y, x]:
            continue
        was_y, was_x = places[y, x, 0] - REACH, places[y, x, 1] - REACH
        best = _difference(pattern, was_y, was_x, rows, weights, y, x, side, channels, ENDLESS)
        at_y, at_x = was_y, was_x
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if not (0 <= y + dy < height and 0 <= x + dx < width):
                    continue
                ty, tx = places[y + dy, x + dx, 0] - REACH - dy, places[y + dy, x + dx, 1] - REACH - dx
                seen = (ty == at_y and tx == at_x) or (ty == was_y and tx == was_x)
                if seen or not (0 <= ty <= last_y and 0 <= tx <= last_x):
                    continue
                cost = _difference(pattern, ty, tx, rows, weights, y, x, side, channels, best)
                if cost < best:
                    best, at_y, at_x = cost, ty, tx
        reach = max(last_y, last_x)
        for _ in range(RANDOM_TRIES):
            ty = min(max(at_y + int((2.0 * rng.random() - 1.0) * reach), 0), last_y)
            tx = min(max(at_x + int((2.0 * rng.random() - 1.0) * reach), 0), last_x)
            cost = _difference(pattern, ty, tx, rows, weights, y, x, side, channels, best)
            if cost < best:
                best, at_y, at_x = cost, ty, tx
            reach //= 2
        if at_y != was_y or at_x != was_x:
            places[y, x, 0], places[y, x, 1] = at_y + REACH, at_x + REACH
            if not known[y, x]:
                for c in range(channels):
                    rows[y + REACH, (x + REACH) * channels + c] = pattern[at_y + REACH, (at_x + REACH) * channels + c]
