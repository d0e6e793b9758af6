"""Kernels that resample the source, see ``rasters``."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads

BLOCK_PIXELS = 4
"""Tile pixels per side of a block whose mean bounds the squared difference from below."""


@njit(cache=True, nogil=True, fastmath=True)
def _average_columns_part(part, source, first, weights, out):
    """Part of the rows of all channels, see ``average_columns``."""
    rows, last = source.shape[1], source.shape[2] - 1
    count, taps = weights.shape
    for cr in range(part.first, part.end):
        c, r = cr // rows, cr % rows
        for x in range(count):
            s = np.float32(0.0)
            for t in range(taps):
                s += weights[x, t] * source[c, r, min(first[x] + t, last)]
            out[c, r, x] = s


def average_columns(source: FloatArray, first: IntArray, weights: FloatArray) -> FloatArray:
    """Average a source over footprints along x: ``out[x] = sum over t of weights[x, t] * source[first[x] + t]``.

    Args:
        source: (C, H, W) float32, linear light.
        first: (count,) first pixel of each footprint, see ``rasters.footprints``.
        weights: (count, taps) float32.

    Returns:
        (C, H, count) float32, linear light.
    """
    channels, rows, _ = source.shape
    out = np.zeros((channels, rows, len(weights)), np.float32)
    in_threads(_average_columns_part, channels * rows, source, first, weights, out)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _display_rows_part(part, columns, first, weights, table, out):
    """Part of the rows of all channels, see ``display_rows``."""
    _, rows, width = columns.shape
    count, taps = weights.shape
    for cy in range(part.first, part.end):
        c, y = cy // count, cy % count
        line = np.zeros(width, np.float32)
        for t in range(taps):
            w, r = weights[y, t], min(first[y] + t, rows - 1)
            for x in range(width):
                line[x] += w * columns[c, r, x]
        for x in range(width):
            k = int(line[x] * np.float32(len(table) - 1) + np.float32(0.5))
            out[c, y, x] = table[min(max(k, 0), len(table) - 1)]


def display_rows(columns: FloatArray, first: IntArray, weights: FloatArray, table: FloatArray) -> FloatArray:
    """Average columns over footprints along y, and turn light into display values.

    Args:
        columns: (C, H, X) float32, linear light.
        first: (count,) first row of each footprint, see ``rasters.footprints``.
        weights: (count, taps) float32.
        table: display values of evenly spaced linear light from 0 to 1.

    Returns:
        (C, count, X) float32 display values.
    """
    channels, _, width = columns.shape
    out = np.zeros((channels, len(weights), width), np.float32)
    in_threads(_display_rows_part, channels * len(weights), columns, first, weights, table, out)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _block_means_part(part, plain, skip_y, skip_x, out):
    """Part of the rows of all channels, see ``block_means``."""
    _, rows, width = plain.shape
    span_y, span_x = (BLOCK_PIXELS - 1) * skip_y, (BLOCK_PIXELS - 1) * skip_x
    for cy in range(part.first, part.end):
        c, y = cy // (rows - span_y), cy % (rows - span_y)
        line = np.zeros(width, np.float32)
        for k in range(BLOCK_PIXELS):
            for x in range(width):
                line[x] += plain[c, y + k * skip_y, x]
        for x in range(width - span_x):
            s = np.float32(0.0)
            for k in range(BLOCK_PIXELS):
                s += line[x + k * skip_x]
            out[c, y, x] = s * np.float32(1.0 / (BLOCK_PIXELS * BLOCK_PIXELS))


def block_means(plain: FloatArray, skip_y: int, skip_x: int) -> FloatArray:
    """Means of BLOCK_PIXELS x BLOCK_PIXELS samples from each sample on.

    Args:
        plain: (C, Y, X) float32.
        skip_y, skip_x: samples from one of the averaged samples to the next.

    Returns:
        (C, Y, X) float32; 0 where a block would leave the raster.
    """
    channels, rows, _ = plain.shape
    out = np.zeros_like(plain)
    whole_rows = max(rows - (BLOCK_PIXELS - 1) * skip_y, 0)
    in_threads(_block_means_part, channels * whole_rows, plain, skip_y, skip_x, out)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _variations_part(part, plain, skip_y, skip_x, out):
    """Part of the rows, see ``block_variations``."""
    width, span_x = plain.shape[2], (BLOCK_PIXELS - 1) * skip_x
    sums, squares = np.zeros(width), np.zeros(width)
    for y in range(part.first, part.end):
        for c in range(len(plain)):
            sums[:], squares[:] = 0.0, 0.0
            for k in range(BLOCK_PIXELS):
                line = plain[c, y + k * skip_y]
                for x in range(width):
                    value = np.float64(line[x])
                    sums[x] += value
                    squares[x] += value * value
            for x in range(width - span_x):
                s = q = 0.0
                for k in range(BLOCK_PIXELS):
                    s += sums[x + k * skip_x]
                    q += squares[x + k * skip_x]
                out[y, x] += q - s * s * (1.0 / (BLOCK_PIXELS * BLOCK_PIXELS))


def block_variations(plain: FloatArray, skip_y: int, skip_x: int) -> FloatArray:
    """How much BLOCK_PIXELS x BLOCK_PIXELS samples from each sample on vary: squares around their mean, summed.

    Args:
        plain: (C, Y, X) float32.
        skip_y, skip_x: samples from one of the summed samples to the next.

    Returns:
        (Y, X) float64, as differences of large sums are taken; 0 where a block would leave the raster.
    """
    out = np.zeros(plain.shape[1:])
    in_threads(_variations_part, max(plain.shape[1] - (BLOCK_PIXELS - 1) * skip_y, 0), plain, skip_y, skip_x, out)
    return out


@njit(cache=True, nogil=True)
def _split_part(part, plain, out):
    """Part of the rows of all channels, see ``split``."""
    _, rows, width = plain.shape
    sy, sx = out.shape[1], out.shape[2]
    for cy in range(part.first, part.end):
        c, y = cy // rows, cy % rows
        for phase in range(sx):
            line, from_ = out[c, y % sy, phase, y // sy], plain[c, y, phase:]
            for k in range((width - phase + sx - 1) // sx):
                line[k] = from_[k * sx]


def split(plain: FloatArray, out: FloatArray) -> None:
    """Fill out (C, sy, sx, Y / sy, X / sx) with the samples of plain (C, Y, X), split by phase."""
    in_threads(_split_part, plain.shape[0] * plain.shape[1], plain, out)
