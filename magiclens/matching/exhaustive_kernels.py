"""The exhaustive search: every offset in the window, for one raster and all four signs of its map.

A candidate's squared difference is bounded from below by how far apart a few coordinates of tile and patch are, and
what these leave out, see ``features``. These are whole numbers of steps, so that bounds are, too:

``(sqrt(|tile - patch|^2) steps + sqrt(n + 1))^2 >= |tile|^2 + |patch|^2 - 2 (sum of tile's coordinate * patch's)``

where the right side is of coordinates in steps: each is half a step wrong at most. In each bucket the offset with the
least bound is compared first, and then those whose bounds allow them to be better than the best so far.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.eights import (
    EIGHT,
    at_most,
    eight_at,
    eight_times,
    four_and_four,
    lesser,
    lowest_bit,
    minus,
    pairs_times_plus,
    plus,
    put_eight,
    times_plus,
    total,
)  # fmt: skip
from magiclens.kernels.threads import in_threads
from magiclens.kernels.uncounted import uncounted
from magiclens.matching.features import GREY, LOW_BITS
from magiclens.matching.raster_kernels import in_steps
from magiclens.matching.rasters import Raster
from magiclens.matching.reachability_kernels import distance_term, reachable
from magiclens.matching.tuples import Found, Tiles, Window
from magiclens.optics.medium import Optics

_ULP = 2.0**-23
"""The share by which an addition of float32 can be wrong, twice."""
_NEVER = 2**30
"""A bound of what is not compared: more than any other."""
_ROW = 2**20
"""What a row adds to a ``_place``."""
_MASK = _ROW - 1
"""Of the numbers in a ``_place``."""
_FAR = 2**24
"""The largest distance term in bounds, along one axis."""


class _Patches(NamedTuple):
    """Where the patches of one facet lie in a raster: those whose centres are in the window, row by row.

    Columns are counted from the first of the EIGHT that hold the window's first.

    Args:
        centre: (x, y) of the facet, mm.
        half: half its pitch, mm.
        first: x, y of the first column and row, in patches; x is a multiple of EIGHT.
        edges: (buckets + 1,) which column is the first in each bucket.
        rows: (buckets + 1,) which row is the first in each bucket.
        x, y: (columns,) and (n_y,) offsets, mm.
        far_x, far_y: (columns,) and (n_y,) int32: what their squares add to bounds; _NEVER beside the window.
    """

    centre: tuple[float, float]
    half: float
    first: tuple[int, int]
    edges: IntArray
    rows: IntArray
    x: FloatArray
    y: FloatArray
    far_x: IntArray
    far_y: IntArray


class _Bounds(NamedTuple):
    """Bounds of squared differences in steps, the distance term included, of the patches in a band of rows.

    Args:
        signs: how many there are.
        all: (signs, blocks, rows, EIGHT) int32, flat.
        least: (blocks, rows, EIGHT) int32, flat: the least of all signs; if there is one, that is ``all``.
        lowest: (blocks EIGHT,) int32, the least of each column.
        tall: how many rows there is room for.
        places: room for the ``_place`` of all these, and of those of one sign once more.
        sums: room for as many sums of squared differences.
    """

    signs: int
    all: IntArray
    least: IntArray
    lowest: IntArray
    tall: int
    places: IntArray
    sums: FloatArray


class _Tile(NamedTuple):
    """A tile as the raster is compared with it.

    Args:
        strips: (signs, S EIGHT) its pixels, mirrored or not, in the order of ``_strips_of``; flat.
        signs: how many there are.
        size: how many values a tile has.
        weights: (2 pairs,) int16, of a patch's numbers in bounds.
        energy: the sum of the squares of its own, int32.
    """

    strips: FloatArray
    signs: int
    size: int
    weights: IntArray
    energy: np.int32


class _Samples(NamedTuple):
    """The samples of a raster, and where those of a patch are.

    Args:
        values: flat.
        strips: (S,) uint64: from a patch's first sample to each strip of EIGHT samples of its rows.
        half: from a strip's first half to its second, which is below the first where rows have half as many pixels.
        columns: (X,) uint64: the first sample of the first patch of each column of patches.
        row: from a row of patches to the next.
    """

    values: FloatArray
    strips: IntArray
    half: np.uint64
    columns: IntArray
    row: np.uint64


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
    columns = np.empty(len(raster.features) * EIGHT, np.uint64)
    for n in range(len(columns)):
        at = n * raster.stride_x
        columns[n] = at % skip * height * width + at // skip
    half = np.uint64(row if tall > 1 else EIGHT // 2)
    return _Samples(raster.samples.reshape(-1), strips, half, columns, np.uint64(raster.stride_y * width))


@njit(cache=True, forceinline=True)
def _place(k, sign, row, column):
    """A bucket, a sign, and a row and column in its band, as a number."""
    return (((k << 2) + sign) << 40) + row * _ROW + column


@njit(cache=True, forceinline=True)
def _taken_apart(place):
    """Bucket, sign, row and column of a ``_place``."""
    return place >> 42, (place >> 40) & 3, (place >> 20) & _MASK, place & _MASK


@njit(cache=True, forceinline=True)
def _start(place, samples, first, size):
    """Where the strips of the tile for a place's sign begin, and the first sample of its patch; unsigned.

    Args:
        place: a ``_place``.
        samples: of the raster.
        first: x, y of the first column and row, in patches.
        size: how many values a tile has.
    """
    _, sign, row, column = _taken_apart(place)
    return np.uint64(sign * size), samples.columns[np.uint64(first[0] + column)] + np.uint64(
        first[1] + row
    ) * samples.row


@njit(cache=True, forceinline=True)
def _squared(sums, tile, begin, samples, at):
    """Sums of squares and those of a strip of a tile less that of a patch."""
    values, half = samples.values, samples.half
    if half == np.uint64(EIGHT // 2):
        apart = minus(eight_at(tile, begin), eight_at(values, at))
    else:
        apart = minus(eight_at(tile, begin), four_and_four(values, at, at + half))
    return times_plus(apart, apart, sums)


@njit(cache=True, forceinline=True)
def _four_sums(tile, places, at, samples, first):
    """Sums of squared differences of the tile and four patches: a processor can add to one while others wait.

    Args:
        tile: that of the facet.
        places: where four follow each other from one on.
        at: which is the first.
        samples: of the raster.
        first: x, y of the first column and row, in patches.
    """
    # unsigned: for other indices each access asks whether it counts from the end
    u, one, lanes, strips, pixels = np.uint64(0), np.uint64(1), np.uint64(EIGHT), samples.strips, tile.strips
    (t0, a0), (t1, a1) = (
        _start(places[at], samples, first, tile.size),
        _start(places[at + one], samples, first, tile.size),
    )
    (t2, a2), (t3, a3) = (
        _start(places[at + one + one], samples, first, tile.size),
        _start(places[at + one + one + one], samples, first, tile.size),
    )
    s0 = s1 = s2 = s3 = eight_times(np.float32(0))
    for k in range(np.uint64(0), np.uint64(len(strips)), one):
        s0 = _squared(s0, pixels, t0 + u, samples, a0 + strips[k])
        s1 = _squared(s1, pixels, t1 + u, samples, a1 + strips[k])
        s2 = _squared(s2, pixels, t2 + u, samples, a2 + strips[k])
        s3 = _squared(s3, pixels, t3 + u, samples, a3 + strips[k])
        u += lanes
    return total(s0), total(s1), total(s2), total(s3)


@njit(cache=True, fastmath={"contract", "reassoc"})
def _describe(values, signs, basis):
    """The ``_Tile`` of a tile's values (C, P, P); signs: 4 if maps of either sign are tried, else 1."""
    channels, pixels = len(values), values.shape[1]
    energy = 0.0
    for c in range(channels):
        for ky in range(pixels):
            for kx in range(pixels):
                energy += (np.float64(values[c, ky, kx]) - GREY) ** 2
    numbers, rest, sum_ = np.zeros(2 * basis.ends[3], np.int16), energy, np.int64(0)
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
        numbers[basis.places[m]] = in_steps(coordinate, basis)
        rest -= coordinate * coordinate
    numbers[2] = in_steps(math.sqrt(max(rest, 0.0)), basis)
    for m in range(len(numbers)):
        sum_ += np.int64(numbers[m]) ** 2
        numbers[m] = -2 * numbers[m]
    numbers[0], numbers[1] = 1 << LOW_BITS, 1
    strips, tall = np.empty((signs, values.size), np.float32), max(EIGHT // pixels, 1)
    for s in range(signs):
        for ky in range(pixels):
            for c in range(channels):
                at = ((ky // tall * channels + c) * tall + ky % tall) * pixels
                for kx in range(pixels):
                    x, y = pixels - 1 - kx if s & 1 else kx, pixels - 1 - ky if s & 2 else ky
                    strips[s, at + kx] = values[c, y, x]
    return _Tile(strips.reshape(-1), signs, values.size, numbers, np.int32(sum_))


@njit(cache=True, forceinline=True)
def _weighted(sums, weights, span, features, starts):
    """Sums for EIGHT patches each of four rows: weights[2 m] and [2 m + 1] times the m-th pair, for m in the span."""
    (s0, s1, s2, s3), (a0, a1, a2, a3) = sums, starts
    at, two, lanes = np.uint64(span[0]) * np.uint64(2 * EIGHT), np.uint64(2), np.uint64(2 * EIGHT)
    for m in range(np.uint64(span[0]), np.uint64(span[1]), np.uint64(1)):
        s0 = pairs_times_plus(features, a0 + at, weights, two * m, s0)
        s1 = pairs_times_plus(features, a1 + at, weights, two * m, s1)
        s2 = pairs_times_plus(features, a2 + at, weights, two * m, s2)
        s3 = pairs_times_plus(features, a3 + at, weights, two * m, s3)
        at += lanes
    return s0, s1, s2, s3


@njit(cache=True, forceinline=True)
def _put_signs(even, odd_x, odd_y, odd, all_, at, plane):
    """Put the bounds of all four signs, and return the least of them."""
    b0, b1 = plus(plus(even, odd_x), plus(odd_y, odd)), plus(minus(even, odd_x), minus(odd_y, odd))
    b2, b3 = minus(plus(even, odd_x), plus(odd_y, odd)), minus(minus(even, odd_x), minus(odd_y, odd))
    put_eight(all_, at, b0)
    put_eight(all_, at + plane, b1)
    put_eight(all_, at + plane + plane, b2)
    put_eight(all_, at + plane + plane + plane, b3)
    return lesser(lesser(b0, b1), lesser(b2, b3))


@njit(cache=True, forceinline=True)
def _bound_band(rows, patches, tile, raster, features, bounds):
    """Fill in the bounds of a band.

    Args:
        rows: the first of the band, and the one after the last.
        patches, tile: of the facet.
        raster: where the patches are.
        features: of the raster, flat.
        bounds: to fill in.
    """
    all_, least, lowest, weights, signs = bounds.all, bounds.least, bounds.lowest, tile.weights, tile.signs
    _, height, pairs, _, _ = raster.features.shape
    tall, step, lanes = bounds.tall, np.uint64(pairs * 2 * EIGHT), np.uint64(EIGHT)
    zero, (e0, e1, e2, e3) = np.int64(0), raster.basis.ends  # numba would compile a function apart for a literal
    plane, zeros, far_y = np.uint64(least.size), eight_times(np.int32(0)), patches.far_y
    last, energy = rows[1] - 1, tile.energy
    for b in range(len(lowest) // EIGHT):
        far, low = eight_at(patches.far_x, np.uint64(b) * lanes), eight_times(np.int32(_NEVER))
        start = np.uint64((patches.first[0] // EIGHT + b) * height + patches.first[1]) * step
        block = np.uint64(b * tall) * lanes
        for j in range(rows[0], rows[1], 4):
            # four rows at once: a processor can add to one while others wait; the last may come more than once
            r1, r2, r3 = min(j + 1, last), min(j + 2, last), min(j + 3, last)
            starts = (
                start + np.uint64(j) * step,
                start + np.uint64(r1) * step,
                start + np.uint64(r2) * step,
                start + np.uint64(r3) * step,
            )
            s0 = plus(far, eight_times(np.int32(energy + far_y[j])))
            s1 = plus(far, eight_times(np.int32(energy + far_y[r1])))
            s2 = plus(far, eight_times(np.int32(energy + far_y[r2])))
            s3 = plus(far, eight_times(np.int32(energy + far_y[r3])))
            a0, a1 = block + np.uint64(j - rows[0]) * lanes, block + np.uint64(r1 - rows[0]) * lanes
            a2, a3 = block + np.uint64(r2 - rows[0]) * lanes, block + np.uint64(r3 - rows[0]) * lanes
            if signs == 1:
                s0, s1, s2, s3 = _weighted((s0, s1, s2, s3), weights, (zero, e3), features, starts)
            else:
                s0, s1, s2, s3 = _weighted((s0, s1, s2, s3), weights, (zero, e0), features, starts)
                x0, x1, x2, x3 = _weighted((zeros, zeros, zeros, zeros), weights, (e0, e1), features, starts)
                y0, y1, y2, y3 = _weighted((zeros, zeros, zeros, zeros), weights, (e1, e2), features, starts)
                b0, b1, b2, b3 = _weighted((zeros, zeros, zeros, zeros), weights, (e2, e3), features, starts)
                s0, s1 = _put_signs(s0, x0, y0, b0, all_, a0, plane), _put_signs(s1, x1, y1, b1, all_, a1, plane)
                s2, s3 = _put_signs(s2, x2, y2, b2, all_, a2, plane), _put_signs(s3, x3, y3, b3, all_, a3, plane)
            put_eight(least, a0, s0)
            put_eight(least, a1, s1)
            put_eight(least, a2, s2)
            put_eight(least, a3, s3)
            low = lesser(lesser(low, lesser(s0, s1)), lesser(s2, s3))
        put_eight(lowest, np.uint64(b) * lanes, low)


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
def _far(along, size, raster, window):
    """What an offset along an axis, mm, adds to bounds of a tile with so many values, by its distance term at least."""
    # q / (1 - q) / m^2 is the distance term, with q of x and y; q + q^2 is less, and that of each apart less again
    q, m2 = (along / (2.0 * window.half)) ** 2, (2.0 * window.half / window.step) ** 2
    return np.int32(min((q + q * q) * size / m2 * raster.basis.steps**2, _FAR))


@njit(cache=True)
def _patches_of(f, tiles, raster, window):
    """The patches of facet f in a raster."""
    centre, half, pixels = (tiles.centres[f, 0], tiles.centres[f, 1]), 0.5 * tiles.pitch, tiles.values.shape[2]
    sx, sy = raster.stride_x, raster.stride_y
    reach_x, reach_y = (pixels - 1) * raster.skip_x, (pixels - 1) * raster.skip_y
    mid_x, mid_y = 0.5 * (reach_x - raster.count_x + 1), 0.5 * (reach_y - raster.count_y + 1)
    x0, n_x = _span(centre[0], window, raster.spacing_x, mid_x, raster.count_x - 1 - reach_x, sx)
    y0, n_y = _span(centre[1], window, raster.spacing_y, mid_y, raster.count_y - 1 - reach_y, sy)
    n_x, n_y, beside = max(n_x, 0), max(n_y, 0), x0 % EIGHT
    columns, size = (beside + n_x + EIGHT - 1) // EIGHT * EIGHT, tiles.values[f].size
    x, y, far_x, far_y = np.zeros(columns), np.empty(n_y), np.full(columns, _NEVER, np.int32), np.empty(n_y, np.int32)
    for n in range(beside, beside + n_x):
        x[n] = ((x0 - beside + n) * sx + mid_x) * raster.spacing_x - centre[0]
        far_x[n] = _far(x[n], size, raster, window)
    for j in range(n_y):
        y[j] = ((y0 + j) * sy + mid_y) * raster.spacing_y - centre[1]
        far_y[j] = _far(y[j], size, raster, window)
    edges = _bucket_rows(x[beside : beside + n_x], window) + beside
    return _Patches(centre, half, (x0 - beside, y0), edges, _bucket_rows(y, window), x, y, far_x, far_y)


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


@njit(cache=True, forceinline=True)
def _highest_bound(limit, tile, basis):
    """The highest bound, int32, that a sum of squared differences below a limit can have."""
    # sums of float32 are a little wrong themselves
    apart = math.sqrt(limit * (1.0 + _ULP * tile.size)) * basis.steps + math.sqrt(len(basis.vectors) + 1.0)
    return np.int32(min(apart * apart + 1.0, _NEVER - 1.0))


@njit(cache=True, forceinline=True)
def _promise(k, columns, worst, rows, count, bounds):
    """Write down the places in a bucket whose bounds are not above the worst; return how many there are then.

    Args:
        k: the bucket.
        columns: its first and its end.
        worst: of the bounds, int32.
        rows: how many the band has.
        count: how many places are written down already.
        bounds: those of the band, and where to write.
    """
    least, lowest, places = bounds.least, bounds.lowest, bounds.places
    many, one, lanes = np.uint64(count), np.uint64(1), np.uint64(EIGHT)
    for b in range(columns[0] // EIGHT, (columns[1] + EIGHT - 1) // EIGHT):
        inside = (1 << min(columns[1] - b * EIGHT, EIGHT)) - (1 << max(columns[0] - b * EIGHT, 0))
        if not at_most(eight_at(lowest, np.uint64(b) * lanes), worst) & inside:
            continue
        at, place = np.uint64(b * bounds.tall) * lanes, _place(k, 0, 0, b * EIGHT)
        for _ in range(rows):
            hits = at_most(eight_at(least, at), worst) & inside
            while hits:
                places[many] = place + lowest_bit(hits)
                many += one
                hits &= hits - 1
            at += lanes
            place += _ROW
    return _with_signs(count, np.int64(many), worst, bounds) if bounds.signs > 1 else np.int64(many)


@njit(cache=True)
def _with_signs(first, end, worst, bounds):
    """Write down places from the first to the end again, with each sign whose bound is not above the worst."""
    places, count, begin = bounds.places, first, len(bounds.places) - (end - first)
    for at in range(begin, len(places)):
        places[at] = places[at - begin + first]
    for at in range(begin, len(places)):
        k, _, row, column = _taken_apart(places[at])
        for sign in range(bounds.signs):
            bound = (
                (sign * len(bounds.lowest) // EIGHT + column // EIGHT) * bounds.tall + row
            ) * EIGHT + column % EIGHT
            if bounds.all[bound] <= worst:
                places[count] = _place(k, sign, row, column)
                count += 1
    return count


@njit(cache=True, forceinline=True)
def _promise_likeliest(k, columns, worst, rows, count, bounds):
    """Write down the place of the least bound of a bucket, with each sign whose bound is not above the worst.

    These bounds become _NEVER. Arguments and result: see ``_promise``.
    """
    all_, least, lowest = bounds.all, bounds.least, bounds.lowest
    first_column = first_row = np.int64(_NEVER * _ROW)
    for n in range(columns[0], columns[1]):
        first_column = min(first_column, np.int64(lowest[np.uint64(n)]) * _ROW + n)
    low, column = first_column >> 20, first_column & _MASK
    if low > worst:
        return count
    at = np.uint64(column // EIGHT * bounds.tall * EIGHT + column % EIGHT)
    for j in range(rows):
        first_row = min(first_row, np.int64(least[at + np.uint64(j * EIGHT)]) * _ROW + j)
    row = first_row & _MASK
    for sign in range(bounds.signs):
        bound = at + np.uint64(row * EIGHT + sign * least.size)
        if all_[bound] <= worst:
            all_[bound] = _NEVER
            bounds.places[count] = _place(k, sign, row, column)
            count += 1
    return count


@njit(cache=True, forceinline=True)
def _compare(count, rows, seen, bounds, best, rule):
    """Compare the tile with the patches of some places, and keep the best of each bucket.

    Args:
        count: how many places there are.
        rows: first and end of the band of rows of offsets.
        seen: the facet's patches and tile, the raster, and its ``_Samples``.
        bounds: where the places are.
        best: (buckets,) least sums, and (buckets, 4) sign, row, column, and whether equals from the left replace it;
            updated in place.
        rule: the window, the optics, whether better offsets are left out that refraction does not allow, and whether
            equals from the left replace what is found.
    """
    (patches, tile, raster, samples), (window, optics, careful, later), (sums, found) = seen, rule, best
    size, first, places, apart = (
        np.float32(tile.size),
        (patches.first[0], patches.first[1] + rows[0]),
        bounds.places,
        bounds.sums,
    )
    for at in range(count, count + 3):
        places[at] = places[0]
    for at in range(np.uint64(0), np.uint64(count), np.uint64(4)):
        apart[at], apart[at + 1], apart[at + 2], apart[at + 3] = _four_sums(tile, places, at, samples, first)
    for at in range(np.uint64(0), np.uint64(count), np.uint64(1)):
        k, sign, row, n = _taken_apart(places[at])
        x, y = patches.x[np.uint64(n)], patches.y[np.uint64(rows[0] + row)]
        sum_ = apart[at] + np.float32(distance_term(x, y, window)) * size
        if sum_ < sums[k] or (sum_ == sums[k] and later and found[k, 3] and n < found[k, 2]):
            if careful and not reachable(patches.centre, (x, y), _map_of(sign, raster), patches.half, optics):
                continue
            sums[k] = sum_
            found[k, 0], found[k, 1], found[k, 2], found[k, 3] = sign, rows[0] + row, n, later


@njit(cache=True, forceinline=True)
def _search_buckets(buckets, rows, seen, bounds, best, rule):
    """Compare the offsets of some buckets whose bounds allow them to be best, beginning with the least bound of each.

    Args:
        buckets: first and end of them, in a row.
        rows: first and end of the band of rows of offsets.
        seen: the facet's patches and tile, the raster, and its ``_Samples``.
        bounds: those of the band; of what has been compared they become _NEVER.
        best: see ``_compare``.
        rule: the window, the optics, and whether better offsets are left out here that refraction does not allow.
    """
    (patches, tile, raster, _), (window, optics, careful) = seen, rule
    for rest in (False, True):
        count = 0
        for k in range(buckets[0], buckets[1]):
            worst, columns = _highest_bound(best[0][k], tile, raster.basis), (patches.edges[k], patches.edges[k + 1])
            if rest:
                count = _promise(k, columns, worst, rows[1] - rows[0], count, bounds)
            else:
                count = _promise_likeliest(k, columns, worst, rows[1] - rows[0], count, bounds)
        if count:
            _compare(count, rows, seen, bounds, best, (window, optics, careful, rest))


@njit(cache=True, forceinline=True)
def _search_band(bucket, rows, seen, features, bounds, rule):
    """Search a row of buckets; refraction is asked only of what is best.

    Args:
        bucket: facet and number of the first bucket.
        rows, seen, bounds: see ``_search_buckets``.
        features: of the raster, flat.
        rule: window, optics, and the best of each bucket so far, which is updated in place.
    """
    seen, bounds = uncounted(seen), uncounted(bounds)
    (patches, tile, raster, _), (window, optics, found), (f, first) = seen, rule, bucket
    size, buckets = np.float32(tile.size), window.buckets
    sums, places = found.errors[f, first : first + buckets] * size, np.full((buckets, 4), -1)
    refused = np.zeros(buckets, np.bool_)
    # all at once, and then those again, one by one, of which refraction does not allow the best
    for turn in range(-1, buckets):
        if turn >= 0 and not refused[turn]:
            continue
        span = (0, buckets) if turn < 0 else (turn, turn + 1)
        _bound_band(rows, patches, tile, raster, features, bounds)
        _search_buckets(span, rows, seen, bounds, (sums, places), (window, optics, turn >= 0))
        for k in range(span[0], span[1]):
            if places[k, 0] >= 0 and not _takes((f, first + k), sums[k] / size, places[k], patches, raster, rule):
                refused[k], sums[k], places[k, 0] = True, found.errors[f, first + k] * size, -1


@njit(cache=True)
def _search_facet(f, tiles, raster, samples, features, rule, mirrored):
    """Try every offset of a raster for facet f, see ``search``; features: those of the raster, flat."""
    tiles, raster, samples = uncounted(tiles), uncounted(raster), uncounted(samples)
    features, rule = uncounted(features), uncounted(rule)
    window = rule[0]
    patches = _patches_of(f, tiles, raster, window)
    if not (len(patches.x) and len(patches.y)):
        return
    tile = _describe(tiles.values[f], 4 if mirrored else 1, raster.basis)
    tallest, blocks = 0, len(patches.far_x) // EIGHT
    for down in range(window.buckets):
        tallest = max(tallest, patches.rows[down + 1] - patches.rows[down])
    size = blocks * tallest * EIGHT
    all_, places = np.empty(tile.signs * size, np.int32), np.empty((tile.signs + mirrored) * size + 4, np.int64)
    least = np.empty(size, np.int32) if mirrored else all_
    bounds = _Bounds(
        tile.signs, all_, least, np.empty(blocks * EIGHT, np.int32), tallest, places, np.empty(len(places), np.float32)
    )
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
