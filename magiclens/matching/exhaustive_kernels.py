"""The exhaustive search: every offset in the window, for one raster and all four signs of its map.

A candidate's squared difference is bounded from below by that of the means of blocks of pixels (the mean of squares is
at least the square of the mean). The bound is computed for whole rows of offsets at once; only offsets that may still
enter their bucket are compared pixel by pixel.
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
def _difference(tile, raster, at, n, limit):
    """Sum of squared differences of a tile against the raster, n offsets to the right; stops once above the limit."""
    phase_y, at_y, phase_x, at_x = at
    channels, pixels, _ = tile.shape
    total = np.float32(0.0)
    for ky in range(pixels):
        for c in range(channels):
            for kx in range(pixels):
                d = tile[c, ky, kx] - raster[c, phase_y[ky], phase_x[kx], at_y[ky], at_x[kx] + n]
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
    sy, sx = raster.samples.shape[1], raster.samples.shape[2]
    norm = np.float32(1.0 / (channels * pixels * pixels))
    reach_x, reach_y = (pixels - 1) * raster.skip_x, (pixels - 1) * raster.skip_y
    mid_x, mid_y = 0.5 * (reach_x - raster.count_x + 1), 0.5 * (reach_y - raster.count_y + 1)
    half = 0.5 * pixels * raster.spacing_x * raster.skip_x / raster.scale_x
    cx, cy = tiles.centres[f, 0], tiles.centres[f, 1]
    x0, n_x = _span(cx, window, raster.spacing_x, mid_x, raster.count_x - 1 - reach_x, sx)
    y0, n_y = _span(cy, window, raster.spacing_y, mid_y, raster.count_y - 1 - reach_y, sy)
    if n_x < 1 or n_y < 1:
        return
    acc = np.zeros(raster.samples.shape[4] + 1, np.float32)
    edges = _bucket_edges(cx, window, raster.spacing_x, (mid_x, x0), sx, n_x)
    at = _Samples(
        np.zeros(pixels, np.int64), np.zeros(pixels, np.int64), np.zeros(pixels, np.int64), np.zeros(pixels, np.int64)
    )  # fmt: skip
    _locate(x0, raster.skip_x, sx, at.phase_x, at.at_x)
    for sign in range(4 if mirrored else 1):
        flip_x, flip_y = (sign & 1) == 1, (sign & 2) == 2
        xx, yy = -raster.scale_x if flip_x else raster.scale_x, -raster.scale_y if flip_y else raster.scale_y
        tile = tiles.values[f, :, :: -1 if flip_y else 1, :: -1 if flip_x else 1]
        block = blocks[f, :, :: -1 if flip_y else 1, :: -1 if flip_x else 1]
        for j in range(n_y):
            ry = (y0 + j * sy + mid_y) * raster.spacing_y - cy
            bucket_y = min(max(int((ry + window.half) / (2.0 * window.half) * window.buckets), 0), window.buckets - 1)
            _locate(y0 + j * sy, raster.skip_y, sy, at.phase_y, at.at_y)
            _bound_row(acc, n_x, block, raster.means, at)
            for b in range(window.buckets):
                k = bucket_y * window.buckets + b
                limit = found.errors[f, k] / norm
                for n in range(edges[b], edges[b + 1]):
                    if acc[n] >= limit:
                        continue
                    rx = (x0 + n * sx + mid_x) * raster.spacing_x - cx
                    far = np.float32(distance_term(rx, ry, window) / norm)
                    if acc[n] + far >= limit:
                        continue
                    ssd = _difference(tile, raster.samples, at, n, limit - far) + far
                    if ssd >= limit:
                        continue
                    if reachable((cx, cy), (rx, ry), (xx, 0.0, yy), half, optics):
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
