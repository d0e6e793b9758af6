"""The exhaustive search: every offset in the window, for one raster and all four signs of its map.

A candidate's squared difference is bounded from below by that of the means of blocks of pixels (the mean of squares is
at least the square of the mean). The bound is computed for whole rows of offsets at once. In each bucket the
offset with the least bound is compared first, pixel by pixel, and then only those whose bounds are not above its
difference.
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

_ROUNDING = np.float32(1e-4)
"""Share by which sums of the same squares in another order cannot differ."""


class _Samples(NamedTuple):
    """Where a tile's pixels are in a raster: phases (P,) and indices (P,) along y and x, see ``build_raster``."""

    phase_y: IntArray
    at_y: IntArray
    phase_x: IntArray
    at_x: IntArray


@njit(cache=True)
def _locate(first, skip, stride, phases, indices):
    """Fill phases and indices of the samples of consecutive tile pixels, from sample ``first`` on."""
    for k in range(len(phases)):
        phases[k] = (first + k * skip) % stride
        indices[k] = (first + k * skip) // stride


# not plain fastmath: the limit is infinite until a bucket has a candidate
@njit(cache=True, fastmath={"contract", "reassoc", "arcp"})
def _is_above(tile, samples, at, skip, limit):
    """Whether ``_difference`` is above a limit, but for rounding: its squares are added up in another order.

    Processors add up four sums side by side at once, but the one sum of ``_difference`` one square after the other.
    """
    phase, y, x = at
    pixels, channels, _ = tile.shape
    total = np.float32(0.0)
    for ky in range(pixels):
        s0 = s1 = s2 = s3 = np.float32(0.0)
        row = y + ky * skip
        for c in range(channels):
            for kx in range(0, pixels, 4):
                at_x = x + kx
                d0 = tile[ky, c, kx] - samples[c, phase, row, at_x]
                d1 = tile[ky, c, kx + 1] - samples[c, phase, row, at_x + 1]
                d2 = tile[ky, c, kx + 2] - samples[c, phase, row, at_x + 2]
                d3 = tile[ky, c, kx + 3] - samples[c, phase, row, at_x + 3]
                s0, s1, s2, s3 = s0 + d0 * d0, s1 + d1 * d1, s2 + d2 * d2, s3 + d3 * d3
        total += (s0 + s1) + (s2 + s3)
        if total > limit:
            return True
    return False


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


@njit(cache=True, fastmath=True)
def _bound_row(acc, count, blocks, means, at):
    """Lower bounds of the sums of squared differences of a row of offsets.

    ``acc[n] = B^2 sum over blocks of (mean of the tile - mean of the patch at the n-th offset)^2``, B = BLOCK_PIXELS.
    """
    phase_y, at_y, phase_x, at_x = at
    channels, per_side, _ = blocks.shape
    weight = np.float32(BLOCK_PIXELS * BLOCK_PIXELS)
    for c in range(channels):
        for by in range(per_side):
            for bx in range(per_side):
                ky, kx = by * BLOCK_PIXELS, bx * BLOCK_PIXELS
                row = means[c, phase_y[ky], phase_x[kx], at_y[ky], at_x[kx] : at_x[kx] + count]
                t = blocks[c, by, bx]
                if c + by + bx == 0:
                    for n in range(count):
                        d = t - row[n]
                        acc[n] = weight * d * d
                else:
                    for n in range(count):
                        d = t - row[n]
                        acc[n] += weight * d * d


@njit(cache=True)
def _fill_rows(values, flip_x, flip_y, tile):
    """Fill in the rows of a tile, (P, C, P), from its values (C, P, P), mirrored or not."""
    pixels = len(tile)
    for ky in range(pixels):
        for c in range(len(values)):
            for kx in range(pixels):
                tile[ky, c, kx] = values[c, pixels - 1 - ky if flip_y else ky, pixels - 1 - kx if flip_x else kx]


@njit(cache=True)
def _least_of_buckets(bounds, edges, least):
    """Fill in the least bound of a row of offsets in each bucket; inf where it has no offset."""
    for b in range(len(least)):
        lowest = np.float32(np.inf)
        for n in range(edges[b], edges[b + 1]):
            lowest = min(lowest, bounds[n])
        least[b] = lowest


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


@njit(cache=True, error_model="numpy")
def _search_facet(f, tiles, blocks, raster, window, mirrored, optics, found):
    """Try every offset of a raster for facet f, see ``search``."""
    channels, pixels = tiles.values.shape[1], tiles.values.shape[2]
    sy, sx = raster.means.shape[1], raster.means.shape[2]
    norm = np.float32(1.0 / (channels * pixels * pixels))
    reach_x, reach_y = (pixels - 1) * raster.skip_x, (pixels - 1) * raster.skip_y
    mid_x, mid_y = 0.5 * (reach_x - raster.count_x + 1), 0.5 * (reach_y - raster.count_y + 1)
    half = 0.5 * pixels * raster.spacing_x * raster.skip_x / raster.scale_x
    cx, cy = tiles.centres[f, 0], tiles.centres[f, 1]
    x0, n_x = _span(cx, window, raster.spacing_x, mid_x, raster.count_x - 1 - reach_x, sx)
    y0, n_y = _span(cy, window, raster.spacing_y, mid_y, raster.count_y - 1 - reach_y, sy)
    if n_x < 1 or n_y < 1:
        return
    bounds = np.empty((n_y, n_x), np.float32)
    least = np.empty((n_y, window.buckets), np.float32)
    tile = np.empty((pixels, channels, pixels), np.float32)
    edges = _bucket_edges(cx, window, raster.spacing_x, (mid_x, x0), sx, n_x)
    at = _Samples(
        np.zeros(pixels, np.int64), np.zeros(pixels, np.int64), np.zeros(pixels, np.int64), np.zeros(pixels, np.int64)
    )  # fmt: skip
    _locate(x0, raster.skip_x, sx, at.phase_x, at.at_x)
    rows = np.empty(n_y, np.int64)
    for j in range(n_y):
        ry = (y0 + j * sy + mid_y) * raster.spacing_y - cy
        rows[j] = min(max(int((ry + window.half) / (2.0 * window.half) * window.buckets), 0), window.buckets - 1)
    for sign in range(4 if mirrored else 1):
        flip_x, flip_y = (sign & 1) == 1, (sign & 2) == 2
        xx, yy = -raster.scale_x if flip_x else raster.scale_x, -raster.scale_y if flip_y else raster.scale_y
        _fill_rows(tiles.values[f], flip_x, flip_y, tile)
        block = blocks[f, :, :: -1 if flip_y else 1, :: -1 if flip_x else 1]
        for j in range(n_y):
            _locate(y0 + j * sy, raster.skip_y, sy, at.phase_y, at.at_y)
            _bound_row(bounds[j], n_x, block, raster.means, at)
            _least_of_buckets(bounds[j], edges, least[j])
        for k in range(window.buckets * window.buckets):
            b = k % window.buckets
            first, end = np.searchsorted(rows, k // window.buckets), np.searchsorted(rows, k // window.buckets + 1)
            if first == end:
                continue
            likely = first + np.argmin(least[first:end, b])
            # differences above this are of no interest: the offset with the least bound has it, or nothing is known yet
            enough = np.float32(np.inf)
            for probing in (True, False):
                for j in range(likely if probing else first, likely + 1 if probing else end):
                    limit = found.errors[f, k] / norm
                    if least[j, b] >= limit or least[j, b] > enough:
                        continue
                    ry, row = (y0 + j * sy + mid_y) * raster.spacing_y - cy, y0 + j * sy
                    for n in range(edges[b], edges[b + 1]):
                        if bounds[j, n] >= limit or bounds[j, n] > (least[j, b] if probing else enough):
                            continue
                        rx, column = (x0 + n * sx + mid_x) * raster.spacing_x - cx, x0 + n * sx
                        far = np.float32(distance_term(rx, ry, window) / norm)
                        if bounds[j, n] + far >= limit or bounds[j, n] + far > enough:
                            continue
                        place, most = (column % raster.skip_x, row, column // raster.skip_x), min(limit, enough)
                        if _is_above(tile, raster.samples, place, raster.skip_y, most * (1 + _ROUNDING) - far):
                            continue
                        ssd = _difference(tile, raster.samples, place, raster.skip_y, most - far) + far
                        if ssd >= limit or ssd > enough:
                            continue
                        if reachable((cx, cy), (rx, ry), (xx, 0.0, yy), half, optics):
                            if probing:
                                enough = ssd
                                break
                            limit = ssd
                            found.errors[f, k] = ssd * norm
                            found.offsets[f, k, 0], found.offsets[f, k, 1] = rx, ry
                            found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2] = xx, 0.0, yy


@njit(cache=True, nogil=True)
def _search_part(part, tiles, blocks, raster, window, mirrored, optics, found):
    """Part of the facets, see ``search``."""
    for f in range(part.first, part.end):
        _search_facet(f, tiles, blocks, raster, window, mirrored, optics, found)


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
    in_threads(_search_part, len(tiles.centres), tiles, blocks, raster, window, mirrored, optics, found)
