"""The exhaustive search: every offset in the window, for one raster and all four signs of its map.

A candidate's squared difference is bounded from below by that of the means of blocks of pixels (the mean of squares is
at least the square of the mean), and more tightly by adding the squared difference of how much tile and patch vary
within their blocks. The bounds are computed for whole rows of offsets at once. In each bucket the likeliest offsets are
compared first, and then those whose bounds are not above their difference. Squares are added up side by side; only for
offsets that may win, but for rounding, they are added up in order, which decides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.matching.raster_kernels import BLOCK_PIXELS
from magiclens.matching.rasters import Raster
from magiclens.matching.reachability_kernels import distance_term, reachable
from magiclens.matching.tuples import Found, Tiles, Window
from magiclens.optics.medium import Optics

_ULP = np.float32(2.0**-22)
"""Four times the share by which an addition of float32 is wrong: two sums of n squares differ by less than n of it."""
_LEAST_SLACK = np.float32(1e-5)
"""By how much bounds of differences of next to nothing can be wrong, squared display values."""


class _Patches(NamedTuple):
    """Where the patches of one facet lie in a raster: those whose centres are in the window, row by row.

    Args:
        centre: x, y of the facet, mm.
        first: x, y of the first sample of the first patch.
        edges: (buckets + 1,) which offset of a row is the first in each bucket.
        rows: (buckets + 1,) which row is the first in each bucket.
        x, y: (n_x,) and (n_y,) offsets, mm.
        samples: (n_x, 2) phase and column of the patches' first samples.
    """

    centre: tuple[float, float]
    first: tuple[int, int]
    edges: IntArray
    rows: IntArray
    x: FloatArray
    y: FloatArray
    samples: IntArray


class _Seen(NamedTuple):
    """One sign of the map: the tile as the raster is compared with it, and what bounds say.

    Args:
        tile: (P, C, P) rows of pixels.
        map: magnitudes along x and y, with their signs.
        means: (n_y, n_x) bounds by the means of blocks.
        tight: (n_y, n_x) bounds by means, and by what they leave out.
    """

    tile: FloatArray
    map: tuple[float, float]
    means: FloatArray
    tight: FloatArray


@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _sum_side_by_side(tile, samples, at, skip, limit):
    """What ``_difference`` sums, but for rounding: four squares at once; it stops once above the limit."""
    # unsigned: for other indices each access asks whether it counts from the end
    phase, y, x, skip_y = np.uint64(at[0]), np.uint64(at[1]), np.uint64(at[2]), np.uint64(skip)
    pixels, channels = np.uint64(tile.shape[0]), np.uint64(tile.shape[1])
    one, two, three, four = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
    total = np.float32(0.0)
    for ky in range(pixels):
        s0 = s1 = s2 = s3 = np.float32(0.0)
        row = y + ky * skip_y
        for c in range(channels):
            for kx in range(np.uint64(0), pixels, four):
                at_x = x + kx
                d0 = tile[ky, c, kx] - samples[c, phase, row, at_x]
                d1 = tile[ky, c, kx + one] - samples[c, phase, row, at_x + one]
                d2 = tile[ky, c, kx + two] - samples[c, phase, row, at_x + two]
                d3 = tile[ky, c, kx + three] - samples[c, phase, row, at_x + three]
                s0, s1, s2, s3 = s0 + d0 * d0, s1 + d1 * d1, s2 + d2 * d2, s3 + d3 * d3
        total += (s0 + s1) + (s2 + s3)
        if total > limit:
            break
    return total


@njit(cache=True, fastmath={"contract"})
def _difference(tile, samples, at, skip, limit):
    """Sum of squared differences of a tile against a patch of the raster; stops once above the limit.

    Args:
        tile: (P, C, P) rows of pixels.
        samples: (C, skip_x, Y, X) of the raster, see ``build_raster``.
        at: phase, row and column of the patch's first sample.
        skip: samples from one row of pixels to the next.
        limit: a larger sum is of no interest.
    """
    phase, y, x = at
    pixels, channels, _ = tile.shape
    total = np.float32(0.0)
    for ky in range(pixels):
        for c in range(channels):
            for kx in range(pixels):
                d = tile[ky, c, kx] - samples[c, phase, y + ky * skip, x + kx]
                total += d * d
        if total > limit:
            break
    return total


@njit(cache=True)
def _block_places(patches, blocks, raster):
    """(blocks, 5) where the means of a tile's blocks are for the first offset: indices of ``raster.means``."""
    channels, side, _ = blocks.shape
    (x0, y0), sy, sx = patches.first, raster.means.shape[1], raster.means.shape[2]
    places = np.empty((channels * side * side, 5), np.int64)
    for m in range(len(places)):
        c, by, bx = m // (side * side), m // side % side, m % side
        y, x = y0 + by * BLOCK_PIXELS * raster.skip_y, x0 + bx * BLOCK_PIXELS * raster.skip_x
        places[m, 0], places[m, 1], places[m, 2], places[m, 3], places[m, 4] = c, y % sy, x % sx, y // sy, x // sx
    return places


@njit(cache=True)
def _block_row(means, place, j, count):
    """The means of one block, see ``_block_places``, in the patches of the j-th row of offsets."""
    x = place[4]
    return means[place[0], place[1], place[2], place[3] + j, x : x + count]


# the order of additions counts: four at once save reading and writing the sums, and change none of them
@njit(cache=True)
def _add_four(acc, means, rows):
    """Add ``(mean - row)^2`` for four blocks, in their order."""
    (t0, t1, t2, t3), (r0, r1, r2, r3) = means, rows
    for n in range(len(acc)):
        d0, d1, d2, d3 = t0 - r0[n], t1 - r1[n], t2 - r2[n], t3 - r3[n]
        acc[n] = acc[n] + d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3


@njit(cache=True)
def _add_one(acc, mean, row):
    """Add ``(mean - row)^2`` for one block."""
    for n in range(len(acc)):
        d = mean - row[n]
        acc[n] += d * d


@njit(cache=True)
def _bound_row(acc, blocks, means, places, j):
    """Sums of squared differences of the means of blocks, for the j-th row of offsets.

    ``acc[n] = sum over blocks of (mean of the tile - mean of the patch at the n-th offset)^2``

    Args:
        acc: (n_x,) filled in.
        blocks: (blocks,) means of the tile's blocks.
        means: (C, sy, sx, Y, X) of the raster.
        places: see ``_block_places``.
        j: the row.
    """
    count, fours = len(acc), len(blocks) - len(blocks) % 4
    acc[:] = 0.0
    for m in range(0, fours, 4):
        near = (_block_row(means, places[m], j, count), _block_row(means, places[m + 1], j, count))
        far = (_block_row(means, places[m + 2], j, count), _block_row(means, places[m + 3], j, count))
        _add_four(acc, (blocks[m], blocks[m + 1], blocks[m + 2], blocks[m + 3]), (near[0], near[1], far[0], far[1]))
    for m in range(fours, len(blocks)):
        _add_one(acc, blocks[m], _block_row(means, places[m], j, count))


@njit(cache=True, fastmath=True)
def _tighten_row(tight, bounds, rest, rests):
    """Make sums of ``_bound_row`` bounds, and add to them the squared differences of what means leave out."""
    for n in range(len(tight)):
        d = rest - rests[n]
        bounds[n] *= np.float32(BLOCK_PIXELS * BLOCK_PIXELS)
        tight[n] = bounds[n] + d * d


@njit(cache=True)
def _lower(lowest, bounds):
    """Note the least bound of each place in a row so far."""
    for n in range(len(lowest)):
        bound, least = bounds[n], lowest[n]
        lowest[n] = bound if bound < least else least


@njit(cache=True)
def _fill_rows(values, flip_x, flip_y, tile):
    """Fill in the rows of a tile, (P, C, P), from its values (C, P, P), mirrored or not."""
    pixels = len(tile)
    for ky in range(pixels):
        for c in range(len(values)):
            for kx in range(pixels):
                tile[ky, c, kx] = values[c, pixels - 1 - ky if flip_y else ky, pixels - 1 - kx if flip_x else kx]


@njit(cache=True)
def _rest_of(values, blocks):
    """How much a tile (C, P, P) varies within its blocks: the norm of what the blocks' means leave out."""
    total = 0.0
    for c in range(len(values)):
        for ky in range(values.shape[1]):
            for kx in range(values.shape[2]):
                total += (np.float64(values[c, ky, kx]) - blocks[c, ky // BLOCK_PIXELS, kx // BLOCK_PIXELS]) ** 2
    return np.float32(math.sqrt(total))


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
def _offset(patches, raster, j, n):
    """Offset of the n-th patch of row j, mm, and phase, row and column of its first sample."""
    row = patches.first[1] + j * raster.means.shape[1]
    return (patches.x[n], patches.y[j]), (patches.samples[n, 0], row, patches.samples[n, 1])


@njit(cache=True)
def _far(offset, window, tile):
    """The distance term of an offset, as a sum over the tile's pixels."""
    norm = np.float32(1.0 / tile.size)
    return np.float32(distance_term(offset[0], offset[1], window) / norm)


@njit(cache=True)
def _can_show(patches, offset, raster, seen, optics):
    """Whether refraction lets the facet show a patch."""
    half = 0.5 * len(seen.tile) * raster.spacing_x * raster.skip_x / raster.scale_x
    return reachable(patches.centre, offset, (seen.map[0], 0.0, seen.map[1]), half, optics)


@njit(cache=True)
def _probe(span, least, limit, patches, raster, seen, window, optics):
    """The first offset with the least bound of ``span``: (row, first, end), that is below the limit and can be shown.

    Returns:
        Its place in the row, or -1, and its sum.
    """
    slack = np.float32(1.0) + _ULP * np.float32(seen.tile.size)
    j, first, end = span
    for n in range(first, end):
        if seen.means[j, n] > least:
            continue
        offset, at = _offset(patches, raster, j, n)
        far = _far(offset, window, seen.tile)
        if least + far >= limit:
            continue
        about = _sum_side_by_side(seen.tile, raster.samples, at, raster.skip_y, limit * slack - far) + far
        if about > limit * slack:
            continue
        if about * slack >= limit:
            sum_ = _difference(seen.tile, raster.samples, at, raster.skip_y, limit - far) + far
            if sum_ >= limit:
                continue
        if _can_show(patches, offset, raster, seen, optics):
            return n, about
    return -1, limit


@njit(cache=True)
def _compare(bucket, most, probed, patches, raster, seen, rule):
    """Compare the offsets of a bucket, row by row, and take each that is better than the best so far.

    What is taken in between counts: the best so far is kept as an error, whose last bits need not be those of its sum.

    Args:
        bucket: facet and number of the bucket; first and end of its rows and of its places in a row; places to look at.
        most: sums above this cannot win. It leaves room for rounding: a bound may be above its sum by the last bits.
        probed: an offset whose sum is known, (row, place, sum).
        patches, raster, seen: where the offsets are.
        rule: window, optics, and the best of each bucket so far.
    """
    (f, k), rows, columns = bucket
    window, optics, found = rule
    size = np.float32(seen.tile.size)
    norm, slack = np.float32(1.0 / seen.tile.size), np.float32(1.0) + _ULP * size
    for j in range(rows[0], rows[1]):
        limit = found.errors[f, k] / norm
        for n in columns:
            if seen.tight[j, n] > most or seen.means[j, n] >= limit:
                continue
            offset, at = _offset(patches, raster, j, n)
            far = _far(offset, window, seen.tile)
            bound = seen.means[j, n] + far
            if bound >= limit or bound > most:
                continue
            sum_ = probed[2]
            if j != probed[0] or n != probed[1]:
                if _sum_side_by_side(seen.tile, raster.samples, at, raster.skip_y, most - far) + far > most:
                    continue
                sum_ = _difference(seen.tile, raster.samples, at, raster.skip_y, min(limit, most) - far) + far
            if sum_ >= limit or sum_ > most or not _can_show(patches, offset, raster, seen, optics):
                continue
            limit, most = sum_, min(most, sum_ * slack + _LEAST_SLACK)
            found.errors[f, k] = sum_ * norm
            found.offsets[f, k, 0], found.offsets[f, k, 1] = offset
            found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2] = seen.map[0], 0.0, seen.map[1]


@njit(cache=True)
def _least_of_bucket(lowest, bounds, rows, places):
    """The least bound of a bucket, inf without one; its first row and a place there; rows and places: first and end."""
    least, row, place = np.float32(np.inf), rows[1], places[0]
    for n in range(places[0], places[1]):
        least = min(least, lowest[n])
    for n in range(places[0], places[1]):
        if lowest[n] == least and least < np.inf:
            j = rows[0]
            while bounds[j, n] != least:
                j += 1
            if j < row:
                row, place = j, n
    return least, row, place


@njit(cache=True)
def _search_bucket(f, k, lowest, patches, raster, seen, columns, rule):
    """Compare the offsets of bucket k with the tile of facet f, and take the best.

    Args:
        f, k: facet and bucket.
        lowest: of each place in a row the least bound of means, and the least tight bound.
        patches, raster, seen: where the offsets are.
        columns: room for the places of a row.
        rule: window, optics, and the best of each bucket so far, which is updated in place.
    """
    window, optics, found = rule
    across, down = k % window.buckets, k // window.buckets
    places = (patches.edges[across], patches.edges[across + 1])
    rows = (patches.rows[down], patches.rows[down + 1])
    limit, slack = (
        found.errors[f, k] / np.float32(1.0 / seen.tile.size),
        np.float32(1.0) + _ULP * np.float32(seen.tile.size),
    )
    tightest, second, at_second = _least_of_bucket(lowest[1], seen.tight, rows, places)
    if tightest > limit * slack + _LEAST_SLACK:
        return
    least, likely, _ = _least_of_bucket(lowest[0], seen.means, rows, places)
    if least >= limit:
        return
    place, about = _probe((likely, places[0], places[1]), least, limit, patches, raster, seen, window, optics)
    most = about * slack + _LEAST_SLACK
    # the offset with the least tight bound is likely to be better still: the more can be left out
    if tightest < most and (likely != second or place != at_second):
        offset, at = _offset(patches, raster, second, at_second)
        far = _far(offset, window, seen.tile)
        sum_ = _sum_side_by_side(seen.tile, raster.samples, at, raster.skip_y, most - far) + far
        if sum_ < most and _can_show(patches, offset, raster, seen, optics):
            most = min(most, sum_ * slack + _LEAST_SLACK)
    exact = np.float32(np.inf)
    if place >= 0 and about <= most:
        offset, at = _offset(patches, raster, likely, place)
        far = _far(offset, window, seen.tile)
        exact = _difference(seen.tile, raster.samples, at, raster.skip_y, limit - far) + far
    count = 0
    for n in range(places[0], places[1]):
        if lowest[1][n] <= most:
            columns[count] = n
            count += 1
    _compare(((f, k), rows, columns[:count]), most, (likely, place, exact), patches, raster, seen, rule)


@njit(cache=True)
def _patches_of(centre, pixels, raster, window):
    """The patches of a facet in a raster, and how many there are in a row and in a column."""
    sy, sx = raster.means.shape[1], raster.means.shape[2]
    reach_x, reach_y = (pixels - 1) * raster.skip_x, (pixels - 1) * raster.skip_y
    mid_x, mid_y = 0.5 * (reach_x - raster.count_x + 1), 0.5 * (reach_y - raster.count_y + 1)
    x0, n_x = _span(centre[0], window, raster.spacing_x, mid_x, raster.count_x - 1 - reach_x, sx)
    y0, n_y = _span(centre[1], window, raster.spacing_y, mid_y, raster.count_y - 1 - reach_y, sy)
    edges = _bucket_edges(centre[0], window, raster.spacing_x, (mid_x, x0), sx, max(n_x, 0))
    x, y, samples = np.empty(max(n_x, 0)), np.empty(max(n_y, 0)), np.empty((max(n_x, 0), 2), np.int64)
    for n in range(n_x):
        column = x0 + n * sx
        x[n] = (column + mid_x) * raster.spacing_x - centre[0]
        samples[n, 0], samples[n, 1] = column % raster.skip_x, column // raster.skip_x
    for j in range(n_y):
        y[j] = (y0 + j * sy + mid_y) * raster.spacing_y - centre[1]
    return _Patches(centre, (x0, y0), edges, _bucket_rows(y, window), x, y, samples), n_x, n_y


@njit(cache=True)
def _search_facet(f, tiles, blocks, raster, rule, mirrored):
    """Try every offset of a raster for facet f, see ``search``."""
    channels, pixels = tiles.values.shape[1], tiles.values.shape[2]
    window = rule[0]
    patches, n_x, n_y = _patches_of((tiles.centres[f, 0], tiles.centres[f, 1]), pixels, raster, window)
    if n_x < 1 or n_y < 1:
        return
    (x0, y0), sy, sx = patches.first, raster.means.shape[1], raster.means.shape[2]
    means, tight = np.empty((n_y, n_x), np.float32), np.empty((n_y, n_x), np.float32)
    lowest, tightest, columns = np.empty(n_x, np.float32), np.empty(n_x, np.float32), np.empty(n_x, np.int64)
    places = _block_places(patches, blocks[f], raster)
    tile, rest = np.empty((pixels, channels, pixels), np.float32), _rest_of(tiles.values[f], blocks[f])
    for sign in range(4 if mirrored else 1):
        flip_x, flip_y = (sign & 1) == 1, (sign & 2) == 2
        xx, yy = -raster.scale_x if flip_x else raster.scale_x, -raster.scale_y if flip_y else raster.scale_y
        _fill_rows(tiles.values[f], flip_x, flip_y, tile)
        block = blocks[f, :, :: -1 if flip_y else 1, :: -1 if flip_x else 1].copy().ravel()
        seen = _Seen(tile, (xx, yy), means, tight)
        for down in range(window.buckets):
            lowest[:], tightest[:] = np.inf, np.inf
            for j in range(patches.rows[down], patches.rows[down + 1]):
                _bound_row(means[j], block, raster.means, places, j)
                rests = raster.rests[y0 % sy, x0 % sx, y0 // sy + j, x0 // sx : x0 // sx + n_x]
                _tighten_row(tight[j], means[j], rest, rests)
                _lower(lowest, means[j])
                _lower(tightest, tight[j])
            for k in range(down * window.buckets, (down + 1) * window.buckets):
                _search_bucket(f, k, (lowest, tightest), patches, raster, seen, columns, rule)


@njit(cache=True, nogil=True)
def _search_part(part, tiles, blocks, raster, rule, mirrored):
    """Part of the facets, see ``search``."""
    for f in range(part.first, part.end):
        _search_facet(f, tiles, blocks, raster, rule, mirrored)


def search(
    tiles: Tiles, blocks: FloatArray, raster: Raster, window: Window, mirrored: bool, optics: Optics, found: Found
) -> None:  # fmt: skip
    """Try every offset of one raster for every facet; keep the best per bucket of the offset window.

    ``M = mean over pixels of (tile - patch)^2 + distance_term`` is minimised (4.2).

    Args:
        tiles: ``Tiles`` (F, C, P, P).
        blocks: (F, C, P / BLOCK_PIXELS, P / BLOCK_PIXELS) float32, the tiles' block means.
        raster: the ``Raster`` to search.
        window: the search window.
        mirrored: whether maps of either sign are tried.
        optics: ``Optics`` in the image frame.
        found: the best of each bucket so far, updated in place.
    """
    in_threads(_search_part, len(tiles.centres), tiles, blocks, raster, (window, optics, found), mirrored)
