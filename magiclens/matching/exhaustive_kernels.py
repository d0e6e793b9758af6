"""The exhaustive search: every offset in the window, for one raster and all four signs of its map.

A candidate's squared difference is bounded from below: the difference of the means of blocks of pixels, and that of how
much tile and patch vary within their blocks, are never larger than that of all pixels. With the square multiplied out,

``|tile - patch|^2 >= |tile|^2 + |patch|^2 - 2 (16 sum over blocks of (tile's mean * patch's mean) + rest * rest)``

so that a row of bounds is a sum of rows of the raster's features, see ``rasters``, each times a number. In each bucket
the offset with the least bound is compared first, and then those whose bounds are below the best so far.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.matching.raster_kernels import BLOCK_PIXELS, GREY, VECTOR
from magiclens.matching.rasters import Raster
from magiclens.matching.reachability_kernels import distance_term, reachable
from magiclens.matching.tuples import Found, Tiles, Window
from magiclens.optics.medium import Optics

_ULP = np.float32(2.0**-23)
"""The share by which an addition of float32 can be wrong, twice."""


class _Patches(NamedTuple):
    """Where the patches of one facet lie in a raster: those whose centres are in the window, row by row.

    Args:
        centre: x, y of the facet, mm.
        half: half its pitch, mm.
        first: x, y of the first sample of the first patch.
        edges: (buckets + 1,) which offset of a row is the first in each bucket.
        rows: (buckets + 1,) which row is the first in each bucket.
        x, y: (n_x,), with some more for whole vectors, and (n_y,) offsets, mm.
        features: (C blocks + 2,) where the first patch's features are in the flat features of the raster: the means of
            its blocks, what they leave out, and its energy.
    """

    centre: tuple[float, float]
    half: float
    first: tuple[int, int]
    edges: IntArray
    rows: IntArray
    x: FloatArray
    y: FloatArray
    features: IntArray


class _Bounds(NamedTuple):
    """Bounds of squared differences, the distance term included, of the patches in a band of rows.

    Args:
        all: (kinds, rows, n_x and some more).
        lowest: (kinds, n_x and some more), the least of each column.
        common: (n_x and some more), room for what all kinds have in common.
    """

    all: FloatArray
    lowest: FloatArray
    common: FloatArray


class _Tile(NamedTuple):
    """A tile as the raster is compared with it.

    Args:
        rows: (signs, P, C, P) its pixels, mirrored or not.
        weights: (kinds, C blocks) of block means in bounds; there is one kind if all signs have equal bounds.
        rest: how much it varies within its blocks.
        energy: the sum of its squares, less what rounding may add to a bound.
    """

    rows: FloatArray
    weights: FloatArray
    rest: np.float32
    energy: np.float32


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"}, forceinline=True)
def _difference(rows, sign, samples, start, strides, limit):
    """Sum of squared differences of a tile against a patch of the raster; some sum above the limit, if it is above.

    Args:
        rows: (signs, P, C, P) of the tile.
        sign: which of them.
        samples: of the raster, flat.
        start: of the patch's first sample.
        strides: from one row of its pixels to the next, and from one channel to the next.
        limit: a larger sum is of no interest.
    """
    # unsigned: for other indices each access asks whether it counts from the end
    pixels, channels, s = np.uint64(rows.shape[1]), np.uint64(rows.shape[2]), np.uint64(sign)
    one, two, three, four = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
    total = np.float32(0.0)
    for ky in range(pixels):
        s0 = s1 = s2 = s3 = np.float32(0.0)
        at = np.uint64(start) + ky * np.uint64(strides[0])
        for c in range(channels):
            for kx in range(np.uint64(0), pixels, four):
                d0 = rows[s, ky, c, kx] - samples[at + kx]
                d1 = rows[s, ky, c, kx + one] - samples[at + kx + one]
                d2 = rows[s, ky, c, kx + two] - samples[at + kx + two]
                d3 = rows[s, ky, c, kx + three] - samples[at + kx + three]
                s0, s1, s2, s3 = s0 + d0 * d0, s1 + d1 * d1, s2 + d2 * d2, s3 + d3 * d3
            at += np.uint64(strides[1])
        total += (s0 + s1) + (s2 + s3)
        if total > limit:
            break
    return total


@njit(cache=True)
def _describe(values, signs, sides, places):
    """The ``_Tile`` of a tile's values (C, P, P).

    Args:
        values: of the tile.
        signs: 4 if maps of either sign are tried, else 1.
        sides: blocks along a side.
        places: how many numbers are added up for a bound.
    """
    channels, pixels = len(values), values.shape[1]
    means, rest, energy = np.zeros((channels, sides, sides)), 0.0, 0.0
    for c in range(channels):
        for ky in range(pixels):
            for kx in range(pixels):
                value = np.float64(values[c, ky, kx]) - GREY
                energy += value * value
                means[c, ky // BLOCK_PIXELS, kx // BLOCK_PIXELS] += value / (BLOCK_PIXELS * BLOCK_PIXELS)
    for c in range(channels):
        for ky in range(pixels):
            for kx in range(pixels):
                rest += (values[c, ky, kx] - GREY - means[c, ky // BLOCK_PIXELS, kx // BLOCK_PIXELS]) ** 2
    rows = np.empty((signs, pixels, channels, pixels), np.float32)
    weights = np.empty((signs if sides > 1 else 1, channels * sides * sides), np.float32)
    for s in range(signs):
        flip_x, flip_y = (s & 1) == 1, (s & 2) == 2
        for c in range(channels):
            for ky in range(pixels):
                for kx in range(pixels):
                    rows[s, ky, c, kx] = values[c, pixels - 1 - ky if flip_y else ky, pixels - 1 - kx if flip_x else kx]
            for b in range(sides * sides if s < len(weights) else 0):
                by, bx = b // sides, b % sides
                mean = means[c, sides - 1 - by if flip_y else by, sides - 1 - bx if flip_x else bx]
                weights[s, c * sides * sides + b] = -2.0 * BLOCK_PIXELS * BLOCK_PIXELS * mean
    return _Tile(
        rows, weights, np.float32(math.sqrt(rest)), np.float32(energy) - _ULP * np.float32(places * values.size)
    )


@njit(cache=True)
def _feature_starts(first, per_side, raster):
    """What ``_Patches`` calls features; first: x, y of the first sample of the first patch."""
    planes, sy, sx, height, width = raster.features.shape
    blocks = per_side * per_side
    starts = np.empty((planes - 2) * blocks + 2, np.int64)
    for m in range(len(starts)):
        of_block = m < len(starts) - 2
        plane, block = (m // blocks, m % blocks) if of_block else (planes + m - len(starts), 0)
        x = first[0] + block % per_side * BLOCK_PIXELS * raster.skip_x
        y = first[1] + block // per_side * BLOCK_PIXELS * raster.skip_y
        starts[m] = (((plane * sy + y % sy) * sx + x % sx) * height + y // sy) * width + x // sx
    return starts


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"}, forceinline=True)
def _bound_row(row, common, weights, features, starts, along):
    """Bounds of one row of patches: ``common``, and weights times the features ``along`` after ``starts``."""
    blocks, count = len(weights), np.uint64(len(common))
    fours = blocks - blocks % 4
    for n in range(count):
        row[n] = common[n]
    for m in range(0, fours, 4):
        w0, w1, w2, w3 = weights[m], weights[m + 1], weights[m + 2], weights[m + 3]
        a0, a1 = np.uint64(starts[m] + along), np.uint64(starts[m + 1] + along)
        a2, a3 = np.uint64(starts[m + 2] + along), np.uint64(starts[m + 3] + along)
        for n in range(count):
            near, far = w0 * features[a0 + n] + w1 * features[a1 + n], w2 * features[a2 + n] + w3 * features[a3 + n]
            row[n] += near + far
    for m in range(fours, blocks):
        w, a = weights[m], np.uint64(starts[m] + along)
        for n in range(count):
            row[n] += w * features[a + n]


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _bound_band(rows, patches, tile, raster, features, window, bounds):
    """Fill in the bounds of a band.

    Args:
        rows: the first of the band, and the one after the last.
        patches, tile: of the facet.
        raster: where the patches are.
        features: of the raster, flat.
        window: the search window.
        bounds: to fill in.
    """
    starts, common, lowest = patches.features, bounds.common, bounds.lowest
    size, unit, count = np.float32(tile.rows[0].size), np.float32(1.0 / window.step), np.uint64(len(common))
    m2 = np.float32((2.0 * window.half / window.step) ** 2)
    lowest[:] = np.inf
    for j in range(rows[0], rows[1]):
        along = j * raster.features.shape[4]
        rest, energy = np.uint64(starts[-2] + along), np.uint64(starts[-1] + along)
        y = np.float32(patches.y[j]) * unit
        for n in range(count):
            x = np.float32(patches.x[n]) * unit
            r2 = x * x + y * y
            far = size * (r2 / m2) / (m2 - r2)  # the distance term, in float32
            common[n] = (tile.energy + features[energy + n]) - np.float32(2.0) * tile.rest * features[rest + n] + far
        for kind in range(len(tile.weights)):
            row, least = bounds.all[kind, j - rows[0]], lowest[kind]
            _bound_row(row, common, tile.weights[kind], features, starts, along)
            for n in range(count):
                least[n] = row[n] if row[n] < least[n] else least[n]


@njit(cache=True)
def _span(centre, window, spacing, mid, last, stride):
    """First samples of patches that lie inside the source, their centres in the window: the first, and how many."""
    first = max(0, math.ceil((centre - window.half) / spacing - mid))
    last = min(last, math.floor((centre + window.half) / spacing - mid))
    return first, (last - first) // stride + 1


@njit(cache=True)
def _bucket_edges(centre, window, spacing, first, stride, count):
    """(buckets + 1,) which offset of a row is the first in each bucket; first: the first patch's middle and sample."""
    edges = np.zeros(window.buckets + 1, np.int64)
    edges[window.buckets] = count
    for b in range(1, window.buckets):
        left = (centre - window.half + 2.0 * window.half * b / window.buckets) / spacing - first[0] - first[1]
        edges[b] = min(max(math.ceil(left / stride), 0), count)
    return edges


@njit(cache=True)
def _bucket_rows(y, window):
    """(buckets + 1,) which row of offsets, y mm, is the first in each bucket."""
    rows = np.empty(len(y), np.int64)
    for j in range(len(y)):
        rows[j] = min(max(int((y[j] + window.half) / (2.0 * window.half) * window.buckets), 0), window.buckets - 1)
    return np.searchsorted(rows, np.arange(window.buckets + 1))


@njit(cache=True)
def _patches_of(f, tiles, raster, window):
    """The patches of facet f in a raster."""
    centre, half, pixels = (tiles.centres[f, 0], tiles.centres[f, 1]), 0.5 * tiles.pitch, tiles.values.shape[2]
    sy, sx = raster.features.shape[1], raster.features.shape[2]
    reach_x, reach_y = (pixels - 1) * raster.skip_x, (pixels - 1) * raster.skip_y
    mid_x, mid_y = 0.5 * (reach_x - raster.count_x + 1), 0.5 * (reach_y - raster.count_y + 1)
    x0, n_x = _span(centre[0], window, raster.spacing_x, mid_x, raster.count_x - 1 - reach_x, sx)
    y0, n_y = _span(centre[1], window, raster.spacing_y, mid_y, raster.count_y - 1 - reach_y, sy)
    n_x, n_y = max(n_x, 0), max(n_y, 0)
    edges = _bucket_edges(centre[0], window, raster.spacing_x, (mid_x, x0), sx, n_x)
    x, y = np.empty((n_x + VECTOR - 1) // VECTOR * VECTOR), np.empty(n_y)
    for n in range(len(x)):
        x[n] = (x0 + n * sx + mid_x) * raster.spacing_x - centre[0]
    for j in range(n_y):
        y[j] = (y0 + j * sy + mid_y) * raster.spacing_y - centre[1]
    features = _feature_starts((x0, y0), pixels // BLOCK_PIXELS, raster)
    return _Patches(centre, half, (x0, y0), edges, _bucket_rows(y, window), x, y, features)


@njit(cache=True)
def _takes(bucket, sum_, sign, offset, patches, raster, rule):
    """Give an offset to its bucket, as refraction lets the facet show its patch; False if it does not."""
    (f, k), (_, optics, found) = bucket, rule
    xx, yy = -raster.scale_x if sign & 1 else raster.scale_x, -raster.scale_y if sign & 2 else raster.scale_y
    if not reachable(patches.centre, offset, (xx, 0.0, yy), patches.half, optics):
        return False
    found.errors[f, k] = sum_
    found.offsets[f, k, 0], found.offsets[f, k, 1] = offset
    found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2] = xx, 0.0, yy
    return True


@njit(cache=True, forceinline=True)
def _search_bucket(bucket, rows, places, bounds, seen, rule):
    """Compare the offsets of a bucket whose bounds are below the best so far, beginning with the least bound.

    Args:
        bucket: facet and number of the bucket.
        rows: first and end of its rows.
        places: first and end of its places in a row.
        bounds: those of the band; of what has been compared they become infinite.
        seen: the facet's patches and tile, the raster, and its samples, flat.
        rule: window, optics, and the best of each bucket so far, which is updated in place.
    """
    (patches, tile, raster, samples), (window, _, found) = seen, rule
    (_, skip, height, width), (_, sy, sx, _, _) = raster.samples.shape, raster.features.shape
    kinds, size = len(tile.weights), np.float32(tile.rows[0].size)
    strides = (raster.skip_y * width, skip * height * width)
    limit, slack = found.errors[bucket] * size, np.float32(1.0) + _ULP * size
    for kind in range(kinds if places[0] < places[1] else 0):
        while True:
            n = places[0]
            for m in range(places[0] + 1, places[1]):
                n = m if bounds.lowest[kind, m] < bounds.lowest[kind, n] else n
            least, second, j = bounds.lowest[kind, n], np.float32(np.inf), -1
            if not least < limit * slack:
                break
            for m in range(rows[1] - rows[0]):
                bound = bounds.all[kind, m, n]
                if bound == least and j < 0:
                    j = m
                elif bound < second:
                    second = bound
            bounds.all[kind, j, n], bounds.lowest[kind, n] = np.inf, second
            offset = (patches.x[n], patches.y[rows[0] + j])
            x, y = patches.first[0] + n * sx, patches.first[1] + (rows[0] + j) * sy
            start = (x % skip * height + y) * width + x // skip
            far = np.float32(distance_term(offset[0], offset[1], window)) * size
            for sign in range(kind, kind + 1) if kinds > 1 else range(len(tile.rows)):
                sum_ = _difference(tile.rows, sign, samples, start, strides, limit - far) + far
                if sum_ < limit and _takes(bucket, sum_ / size, sign, offset, patches, raster, rule):
                    limit = sum_


@njit(cache=True)
def _search_facet(f, tiles, raster, samples, features, rule, mirrored):
    """Try every offset of a raster for facet f, see ``search``; samples, features: those of the raster, flat."""
    pixels, window = tiles.values.shape[2], rule[0]
    patches = _patches_of(f, tiles, raster, window)
    if not (len(patches.x) and len(patches.y)):
        return
    tile = _describe(tiles.values[f], 4 if mirrored else 1, pixels // BLOCK_PIXELS, len(patches.features) + 2)
    kinds, tallest, width = len(tile.weights), np.diff(patches.rows).max(), len(patches.x)
    bounds = _Bounds(
        np.empty((kinds, tallest, width), np.float32), np.empty((kinds, width), np.float32), np.empty(width, np.float32)
    )
    for k in range(window.buckets * window.buckets):
        down, across = k // window.buckets, k % window.buckets
        rows = (patches.rows[down], patches.rows[down + 1])
        if across == 0:
            _bound_band(rows, patches, tile, raster, features, window, bounds)
        places = (patches.edges[across], patches.edges[across + 1])
        _search_bucket((f, k), rows, places, bounds, (patches, tile, raster, samples), rule)


@njit(cache=True, nogil=True)
def _search_part(part, tiles, raster, rule, mirrored):
    """Part of the facets, see ``search``."""
    samples, features = raster.samples.reshape(-1), raster.features.reshape(-1)
    for f in range(part.first, part.end):
        _search_facet(f, tiles, raster, samples, features, rule, mirrored)


def search(tiles: Tiles, raster: Raster, window: Window, mirrored: bool, optics: Optics, found: Found) -> None:
    """Try every offset of one raster for every facet; keep the best per bucket of the offset window.

    ``M = mean over pixels of (tile - patch)^2 + distance_term`` is minimised (4.2).

    Args:
        tiles: ``Tiles`` (F, C, P, P).
        raster: the ``Raster`` to search.
        window: the search window.
        mirrored: whether maps of either sign are tried.
        optics: ``Optics`` in the image frame.
        found: the best of each bucket so far, updated in place.
    """
    in_threads(_search_part, len(tiles.centres), tiles, raster, (window, optics, found), mirrored)
