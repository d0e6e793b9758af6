"""Kernels that resample the source, see ``rasters``."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads

BLOCK_PIXELS = 4
"""Tile pixels per side of a block whose mean bounds the squared difference from below."""
GREY = np.float32(0.5)
"""Display value from which others are counted where their squares are summed, so that sums, and what rounding makes of
them, stay small."""
VECTOR = 16
"""Rows of numbers are summed in whole vectors of so many."""


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
    skip = out.shape[1]
    line = np.zeros(width, np.float32)
    for cy in range(part.first, part.end):
        c, y = cy // count, cy % count
        line[:] = 0.0
        for t in range(taps):
            w, r = weights[y, t], min(first[y] + t, rows - 1)
            for x in range(width):
                line[x] += w * columns[c, r, x]
        for phase in range(skip):
            for n in range((width - phase + skip - 1) // skip):
                k = int(line[n * skip + phase] * np.float32(len(table) - 1) + np.float32(0.5))
                out[c, phase, y, n] = table[min(max(k, 0), len(table) - 1)]


def display_rows(
    columns: FloatArray, first: IntArray, weights: FloatArray, table: FloatArray, skip: int
) -> FloatArray:  # fmt: skip
    """Average columns over footprints along y, and turn light into display values.

    Args:
        columns: (C, H, X) float32, linear light.
        first: (count,) first row of each footprint, see ``rasters.footprints``.
        weights: (count, taps) float32.
        table: display values of evenly spaced linear light from 0 to 1.
        skip: number of phases into which rows are split.

    Returns:
        (C, skip, count, X / skip) float32 display values: sample (y, x) at [:, x % skip, y, x // skip].
    """
    channels, _, width = columns.shape
    out = np.zeros((channels, skip, len(weights), -(-width // skip)), np.float32)
    in_threads(_display_rows_part, channels * len(weights), columns, first, weights, table, out)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _blocks_part(part, samples, skip_y, features, sums):
    """Part of the rows of samples: the means of blocks, and in sums (2, Y, X) the squares around and of these."""
    channels, skip, _, width = samples.shape
    _, sy, sx, _, _ = features.shape
    count, step = width - BLOCK_PIXELS + 1, np.float32(1.0 / BLOCK_PIXELS)
    tall, apart, mean = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width * skip, np.float32)
    rest, energy = np.zeros((skip, width), np.float32), np.zeros((skip, width), np.float32)
    for y in range(part.first, part.end):
        rest[:], energy[:] = 0.0, 0.0
        for c in range(channels):
            for phase in range(skip):
                # first along y, then along x: squares around the mean of means add up without differences of large sums
                for n in range(width):
                    s = q = np.float32(0.0)
                    for k in range(BLOCK_PIXELS):
                        s += samples[c, phase, y + k * skip_y, n]
                    s *= step
                    for k in range(BLOCK_PIXELS):
                        q += (samples[c, phase, y + k * skip_y, n] - s) ** 2
                    tall[n], apart[n] = s, q
                for n in range(count):
                    s = q = np.float32(0.0)
                    for k in range(BLOCK_PIXELS):
                        s += tall[n + k]
                    s *= step
                    for k in range(BLOCK_PIXELS):
                        q += apart[n + k] + BLOCK_PIXELS * (tall[n + k] - s) ** 2
                    s -= GREY
                    rest[phase, n] += q
                    energy[phase, n] += np.float32(BLOCK_PIXELS * BLOCK_PIXELS) * s * s
                    mean[n * skip + phase] = s
            for phase in range(sx):
                for n in range((count * skip - phase + sx - 1) // sx):
                    features[c, y % sy, phase, y // sy, n] = mean[n * sx + phase]
        for phase in range(skip):
            for n in range(count):
                sums[0, y, n * skip + phase], sums[1, y, n * skip + phase] = rest[phase, n], energy[phase, n]


@njit(cache=True, nogil=True, fastmath=True)
def _norms_part(part, sums, steps, per_side, features):
    """Part of the rows of samples: what blocks' means leave out of the patch that begins there, and its energy."""
    channels, (_, sy, sx, _, _), width = len(features) - 2, features.shape, sums.shape[2]
    count = width - (per_side - 1) * steps[1]
    rest, energy = np.zeros(width, np.float32), np.zeros(width, np.float32)
    for y in range(part.first, part.end):
        rest[:], energy[:] = 0.0, 0.0
        for b in range(per_side * per_side):
            row, column = y + b // per_side * steps[0], b % per_side * steps[1]
            for x in range(count):
                rest[x] += sums[0, row, column + x]
                energy[x] += sums[1, row, column + x]
        for x in range(count):
            energy[x] += rest[x]
            rest[x] = math.sqrt(rest[x])
        for phase in range(sx):
            for n in range((count - phase + sx - 1) // sx):
                features[channels, y % sy, phase, y // sy, n] = rest[n * sx + phase]
                features[channels + 1, y % sy, phase, y // sy, n] = energy[n * sx + phase]


def patch_features(samples: FloatArray, skip_y: int, strides: tuple[int, int], pixels: int) -> FloatArray:
    """What bounds say of patches: the means of blocks, what these leave out, and the sum of squares.

    Args:
        samples: (C, skip, Y, X / skip) float32 display values, see ``display_rows``.
        skip_y: samples between two neighbouring pixels of a patch along y.
        strides: samples between two neighbouring offsets along y and x.
        pixels: P, along a patch's side.

    Returns:
        (C + 2, sy, sx, Y / sy, X / sx and some more) float32. For sample (y, x), at [:, y % sy, x % sx, y // sy,
        x // sx]: for each channel the mean, less GREY, of the block of pixels that begins there; of the patch that
        begins there, the norm of what its blocks' means leave out, and the sum of (value - GREY)^2. It is meaningless
        where they would leave the raster. The last VECTOR columns are there to be read with others.
    """
    channels, skip, rows, width = samples.shape
    (sy, sx), step = strides, BLOCK_PIXELS * skip_y
    features = np.zeros((channels + 2, sy, sx, -(-rows // sy), -(-width * skip // sx) + VECTOR), np.float32)
    sums = np.zeros((2, rows, width * skip), np.float32)
    in_threads(_blocks_part, max(rows - step + skip_y, 0), samples, skip_y, features, sums)
    per_side = pixels // BLOCK_PIXELS
    whole = max(rows - per_side * step + skip_y, 0)
    in_threads(_norms_part, whole, sums, (step, BLOCK_PIXELS * skip), per_side, features)
    return features
