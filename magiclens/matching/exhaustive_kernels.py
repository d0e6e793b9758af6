"""The exhaustive search: every offset in the window, for one raster and all four signs of its map.

A candidate's squared difference is bounded from below by a few coordinates of tile and patch, see ``features``, and by
what these leave out,

``|tile - patch|^2 >= |tile|^2 + |patch|^2 - 2 (sum of (tile's coordinate * patch's) + rest * rest)``

so that a row of bounds is a sum of rows of the raster's features, each times a number. In each bucket the offset with
the least bound is compared first, and then those whose bounds are below the best so far.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.eights import (
    EIGHT,
    eight_at,
    eight_times,
    four_and_four,
    lesser,
    minus,
    plus,
    put_eight,
    times_plus,
    total,
)  # fmt: skip
from magiclens.kernels.threads import in_threads
from magiclens.matching.features import GREY
from magiclens.matching.raster_kernels import kept_of_energy
from magiclens.matching.rasters import Raster
from magiclens.matching.reachability_kernels import distance_term, reachable
from magiclens.matching.tuples import Found, Tiles, Window
from magiclens.optics.medium import Optics

_ULP = np.float32(2.0**-23)
"""The share by which an addition of float32 can be wrong, twice."""


class _Patches(NamedTuple):
    """Where the patches of one facet lie in a raster: those whose centres are in the window, row by row.

    Args:
        centre: (x, y) of the facet, mm.
        half: half its pitch, mm.
        first: x, y of the first patch, in patches.
        edges: (buckets + 1,) which offset of a row is the first in each bucket.
        rows: (buckets + 1,) which row is the first in each bucket.
        x, y: (n_x,) and (n_y,) offsets, mm.
        x2: (n_x and some more,) float32: the squares of x, of that of the window's side.
    """

    centre: tuple[float, float]
    half: float
    first: tuple[int, int]
    edges: IntArray
    rows: IntArray
    x: FloatArray
    y: FloatArray
    x2: FloatArray


class _Bounds(NamedTuple):
    """Bounds of squared differences, the distance term included, of the patches in a band of rows.

    Args:
        all: (signs, rows, n_x and some more); without meaning if there is one sign.
        least: (rows, n_x and some more), the least of all signs.
        lowest: (n_x and some more), the least of each column.
    """

    all: FloatArray
    least: FloatArray
    lowest: FloatArray


class _Tile(NamedTuple):
    """A tile as the raster is compared with it.

    Args:
        strips: (signs, S EIGHT) its pixels, mirrored or not, in the order of ``_strips_of``.
        weights: (n + 2,) of a patch's features in bounds.
        energy: the sum of its squares, less what rounding may add to a bound.
    """

    strips: FloatArray
    weights: FloatArray
    energy: np.float32


class _Samples(NamedTuple):
    """The samples of a raster, and where those of a patch are.

    Args:
        values: flat.
        strips: (S,) uint64: from a patch's first sample to each strip of EIGHT samples of its rows.
        half: from a strip's first half to its second, which is below the first where rows have half as many pixels.
    """

    values: FloatArray
    strips: IntArray
    half: np.uint64


@njit(cache=True)
def _strips_of(raster, pixels):
    """The ``_Samples`` of a raster for patches of so many pixels along a side."""
    channels, skip, height, width = raster.samples.shape
    tall, row, channel = max(EIGHT // pixels, 1), raster.skip_y * width, skip * height * width
    strips, u = np.empty(channels * pixels * pixels // EIGHT, np.uint64), 0
    for ky in range(0, pixels, tall):
        for c in range(channels):
            for kx in range(0, pixels, EIGHT):
                strips[u] = ky * row + c * channel + kx
                u += 1
    return _Samples(raster.samples.reshape(-1), strips, np.uint64(row if tall > 1 else EIGHT // 2))


@njit(cache=True, forceinline=True)
def _difference(tile, begin, values, strips, half, start, limit):
    """Sum of squared differences of a tile and a patch; some sum above the limit, if it is above.

    Args:
        tile: its strips, flat.
        begin: where those of the sign begin.
        values, strips, half: the ``_Samples``.
        start: the patch's first sample.
        limit: a larger sum is of no interest.
    """
    # unsigned: for other indices each access asks whether it counts from the end
    four, lanes, sums, found = np.uint64(4), np.uint64(EIGHT), eight_times(np.float32(0.0)), np.float32(0.0)
    for u in range(np.uint64(0), np.uint64(len(strips)), np.uint64(1)):
        at = start + strips[u]
        apart = minus(eight_at(tile, begin + u * lanes), four_and_four(values, at, at + half))
        sums = times_plus(apart, apart, sums)
        if u % four == four - np.uint64(1):
            found = total(sums)
            if found > limit:
                return found
    return total(sums)


@njit(cache=True, fastmath={"contract", "reassoc"})
def _describe(values, signs, basis):
    """The ``_Tile`` of a tile's values (C, P, P); signs: 4 if maps of either sign are tried, else 1."""
    channels, pixels = len(values), values.shape[1]
    energy = 0.0
    for c in range(channels):
        for ky in range(pixels):
            for kx in range(pixels):
                energy += (np.float64(values[c, ky, kx]) - GREY) ** 2
    weights, rest = np.empty(len(basis.vectors) + 2, np.float32), energy
    for m in range(len(basis.vectors)):
        mixture, wave_y, wave_x = basis.vectors[m, 0], basis.vectors[m, 1], basis.vectors[m, 2]
        coordinate = 0.0
        for c in range(channels):
            inner = 0.0
            for ky in range(pixels):
                along = 0.0
                for kx in range(pixels):
                    along += basis.waves[wave_x, kx] * (np.float64(values[c, ky, kx]) - GREY)
                inner += basis.waves[wave_y, ky] * along
            coordinate += basis.mixtures[mixture, c] * inner
        weights[m + 2] = -2.0 * coordinate
        rest -= coordinate * coordinate
    weights[0], weights[1] = 1.0, -2.0 * math.sqrt(max(rest, 0.0))
    strips, tall = np.empty((signs, values.size), np.float32), max(EIGHT // pixels, 1)
    for s in range(signs):
        for ky in range(pixels):
            for c in range(channels):
                at = ((ky // tall * channels + c) * tall + ky % tall) * pixels
                for kx in range(pixels):
                    x, y = pixels - 1 - kx if s & 1 else kx, pixels - 1 - ky if s & 2 else ky
                    strips[s, at + kx] = values[c, y, x]
    return _Tile(strips, weights, np.float32(energy * kept_of_energy(len(basis.vectors))))


@njit(cache=True, forceinline=True)
def _weighted(sums, weights, span, features, start, step):
    """``sums + sum over m in the span of weights[m] * features[start + m * step]``, for EIGHT patches at once."""
    at = start + np.uint64(span[0]) * step
    for m in range(span[0], span[1]):
        sums = times_plus(eight_times(weights[m]), eight_at(features, at), sums)
        at += step
    return sums


@njit(cache=True)
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
    all_, least, lowest, weights, x2 = bounds.all, bounds.least, bounds.lowest, tile.weights, patches.x2
    _, planes, width = raster.features.shape
    count, signs, step = np.uint64(len(lowest)), len(all_), np.uint64(width)
    zero, (e0, e1, e2, e3) = np.int64(0), raster.basis.ends  # numba would compile a function apart for a literal
    m2, lanes, zeros = (2.0 * window.half / window.step) ** 2, np.uint64(EIGHT), eight_times(np.float32(0.0))
    energy, unit = eight_times(tile.energy), eight_times(np.float32(tile.strips[0].size / m2))
    for n in range(np.uint64(0), count, lanes):
        put_eight(lowest, n, eight_times(np.float32(np.inf)))
    for j in range(rows[0], rows[1]):
        start = np.uint64((patches.first[1] + j) * planes * width + patches.first[0])
        y2, row = eight_times(np.float32((patches.y[j] / (2.0 * window.half)) ** 2)), np.uint64(j - rows[0]) * count
        for n in range(np.uint64(0), count, lanes):
            # q / (1 - q) / m^2 is the distance term, q + q^2 is less
            q = plus(eight_at(x2, n), y2)
            low = times_plus(times_plus(q, q, q), unit, energy)
            if signs == 1:
                low = _weighted(low, weights, (zero, e3), features, start + n, step)
            else:
                even = _weighted(low, weights, (zero, e0), features, start + n, step)
                odd_x = _weighted(zeros, weights, (e0, e1), features, start + n, step)
                odd_y = _weighted(zeros, weights, (e1, e2), features, start + n, step)
                odd = _weighted(zeros, weights, (e2, e3), features, start + n, step)
                b0, b1 = plus(plus(even, odd_x), plus(odd_y, odd)), plus(minus(even, odd_x), minus(odd_y, odd))
                b2, b3 = minus(plus(even, odd_x), plus(odd_y, odd)), minus(minus(even, odd_x), minus(odd_y, odd))
                at, plane = row + n, np.uint64(all_[0].size)
                put_eight(all_, at, b0)
                put_eight(all_, at + plane, b1)
                put_eight(all_, at + plane + plane, b2)
                put_eight(all_, at + plane + plane + plane, b3)
                low = lesser(lesser(b0, b1), lesser(b2, b3))
            put_eight(least, row + n, low)
            put_eight(lowest, n, lesser(low, eight_at(lowest, n)))


@njit(cache=True)
def _span(centre, window, spacing, mid, last, stride):
    """Patches that lie inside the source, their centres in the window: the first, in patches, and how many."""
    first = max(0, math.ceil(((centre - window.half) / spacing - mid) / stride))
    last = min(last, math.floor((centre + window.half) / spacing - mid)) // stride
    return first, last - first + 1


@njit(cache=True)
def _bucket_rows(y, window):
    """(buckets + 1,) which row of offsets, y mm, is the first in each bucket."""
    rows = np.zeros(window.buckets + 1, np.int64)
    for j in range(len(y)):
        bucket = min(max(int((y[j] + window.half) / (2.0 * window.half) * window.buckets), 0), window.buckets - 1)
        rows[bucket + 1] += 1
    for k in range(window.buckets):
        rows[k + 1] += rows[k]
    return rows


@njit(cache=True)
def _patches_of(f, tiles, raster, window):
    """The patches of facet f in a raster."""
    centre, half, pixels = (tiles.centres[f, 0], tiles.centres[f, 1]), 0.5 * tiles.pitch, tiles.values.shape[2]
    sx, sy = raster.stride_x, raster.stride_y
    reach_x, reach_y = (pixels - 1) * raster.skip_x, (pixels - 1) * raster.skip_y
    mid_x, mid_y = 0.5 * (reach_x - raster.count_x + 1), 0.5 * (reach_y - raster.count_y + 1)
    x0, n_x = _span(centre[0], window, raster.spacing_x, mid_x, raster.count_x - 1 - reach_x, sx)
    y0, n_y = _span(centre[1], window, raster.spacing_y, mid_y, raster.count_y - 1 - reach_y, sy)
    n_x, n_y = max(n_x, 0), max(n_y, 0)
    x, y, x2 = np.empty(n_x), np.empty(n_y), np.zeros((n_x + EIGHT - 1) // EIGHT * EIGHT, np.float32)
    for n in range(n_x):
        x[n] = ((x0 + n) * sx + mid_x) * raster.spacing_x - centre[0]
        x2[n] = (x[n] / (2.0 * window.half)) ** 2
    for j in range(n_y):
        y[j] = ((y0 + j) * sy + mid_y) * raster.spacing_y - centre[1]
    return _Patches(centre, half, (x0, y0), _bucket_rows(x, window), _bucket_rows(y, window), x, y, x2)


@njit(cache=True)
def _map_of(sign, raster):
    """The map of a sign as (xx, xy, yy)."""
    return -raster.scale_x if sign & 1 else raster.scale_x, 0.0, -raster.scale_y if sign & 2 else raster.scale_y


@njit(cache=True)
def _takes(bucket, error, place, patches, raster, rule):
    """Give an offset to its bucket, as refraction lets the facet show its patch; False if it does not.

    Args:
        bucket: facet and number of the bucket.
        error: of the offset.
        place: (3,) sign, row, and place in the row.
        patches: of the facet.
        raster: where they are.
        rule: window, optics, and the best of each bucket so far.
    """
    (f, k), (_, optics, found), offset = bucket, rule, (patches.x[place[2]], patches.y[place[1]])
    map_ = _map_of(place[0], raster)
    if not reachable(patches.centre, offset, map_, patches.half, optics):
        return False
    found.errors[f, k] = error
    found.offsets[f, k, 0], found.offsets[f, k, 1] = offset
    found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2] = map_
    return True


@njit(cache=True)
def _search_buckets(buckets, band, seen, bounds, best, rule):
    """Compare the offsets of some buckets whose bounds are below the best so far, beginning with the least bound.

    Args:
        buckets: first and end of them, in a row.
        band: first and end of the rows of offsets.
        seen: the facet's patches and tile, the raster, and its ``_Samples``.
        bounds: those of the band; of what has been compared they become infinite.
        best: (buckets,) least sums, and (buckets, 3) sign, row and place in the row; updated in place.
        rule: the window, the optics, and whether better offsets are left out here that refraction does not allow.
    """
    # tuples are taken apart here: each time that costs as much as comparing a tile with some patches
    (patches, tile, raster, samples), (window, optics, careful), (sums, places) = seen, rule, best
    (x, y), edges, (x0, y0) = (patches.x, patches.y), patches.edges, patches.first
    (values, strips, half), pixels, (_, skip, height, width) = samples, tile.strips, raster.samples.shape
    lowest, least, all_, signs = bounds.lowest, bounds.least, bounds.all, len(pixels)
    size, slack = np.float32(pixels[0].size), np.float32(1.0) + _ULP * np.float32(pixels[0].size)
    for k in range(buckets[0], buckets[1]):
        likeliest, limit = edges[k], sums[k]
        for n in range(edges[k] + 1, edges[k + 1]):
            likeliest = n if lowest[n] < lowest[likeliest] else likeliest
        if edges[k] == edges[k + 1] or not lowest[likeliest] < limit * slack:
            continue
        # first the least bound alone, then all places from left to right
        for turn in range(edges[k] - 1, edges[k + 1]):
            alone = turn < edges[k]
            n = likeliest if alone else turn
            worst = lowest[n] if alone else limit * slack
            for j in range(band[1] - band[0] if lowest[n] <= worst else 0):
                if least[j, n] > worst:
                    continue
                least[j, n] = np.inf
                at_x, at_y, row = (x0 + n) * raster.stride_x, (y0 + band[0] + j) * raster.stride_y, band[0] + j
                start = np.uint64((at_x % skip * height + at_y) * width + at_x // skip)
                far = np.float32(distance_term(x[n], y[row], window)) * size
                for sign in range(signs):
                    if signs > 1 and not all_[sign, j, n] < limit * slack:
                        continue
                    begin = np.uint64(sign) * np.uint64(pixels.shape[1])
                    sum_ = _difference(pixels, begin, values, strips, half, start, limit - far) + far
                    if sum_ < limit:
                        if careful and not reachable(
                            patches.centre, (x[n], y[row]), _map_of(sign, raster), patches.half, optics
                        ):
                            continue
                        limit = sum_
                        places[k, 0], places[k, 1], places[k, 2] = sign, row, n
                worst = worst if alone else limit * slack
        sums[k] = limit


@njit(cache=True)
def _search_band(bucket, rows, seen, features, bounds, rule):
    """Search a row of buckets; refraction is asked only of what is best.

    Args:
        bucket: facet and number of the first bucket.
        rows, seen, bounds: see ``_search_buckets``.
        features: of the raster, flat.
        rule: window, optics, and the best of each bucket so far, which is updated in place.
    """
    (patches, tile, raster, _), (window, optics, found), (f, first) = seen, rule, bucket
    size, buckets = np.float32(tile.strips[0].size), window.buckets
    sums, places = found.errors[f, first : first + buckets] * size, np.full((buckets, 3), -1)
    _bound_band(rows, patches, tile, raster, features, window, bounds)
    _search_buckets((np.int64(0), buckets), rows, seen, bounds, (sums, places), (window, optics, buckets < 0))
    for k in range(buckets):
        if places[k, 0] >= 0 and not _takes((f, first + k), sums[k] / size, places[k], patches, raster, rule):
            sums[k], places[k, 0] = found.errors[f, first + k] * size, -1
            _bound_band(rows, patches, tile, raster, features, window, bounds)
            _search_buckets((k, k + 1), rows, seen, bounds, (sums, places), (window, optics, buckets > 0))
            if places[k, 0] >= 0:
                _takes((f, first + k), sums[k] / size, places[k], patches, raster, rule)


@njit(cache=True)
def _search_facet(f, tiles, raster, samples, features, rule, mirrored):
    """Try every offset of a raster for facet f, see ``search``; features: those of the raster, flat."""
    window = rule[0]
    patches = _patches_of(f, tiles, raster, window)
    if not (len(patches.x) and len(patches.y)):
        return
    tile = _describe(tiles.values[f], 4 if mirrored else 1, raster.basis)
    tallest, width = 0, len(patches.x2)
    for down in range(window.buckets):
        tallest = max(tallest, patches.rows[down + 1] - patches.rows[down])
    all_ = np.empty((len(tile.strips), tallest, width), np.float32)
    bounds = _Bounds(all_, np.empty((tallest, width), np.float32), np.empty(width, np.float32))
    for down in range(window.buckets):
        rows = (patches.rows[down], patches.rows[down + 1])
        _search_band((f, down * window.buckets), rows, (patches, tile, raster, samples), features, bounds, rule)


@njit(cache=True, nogil=True)
def _search_part(part, tiles, raster, rule, mirrored):
    """Part of the facets, see ``search``."""
    samples, features = _strips_of(raster, tiles.values.shape[2]), raster.features.reshape(-1)
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
