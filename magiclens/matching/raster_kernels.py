"""Kernels that resample the source, see ``rasters``."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.eights import EIGHT
from magiclens.kernels.threads import in_threads
from magiclens.matching.features import GREY, Basis


@njit(cache=True, nogil=True, fastmath=True)
def _average_columns_part(part, source, first, weights, out):
    """Part of the rows, see ``average_columns``."""
    last, (count, taps) = source.shape[2] - 1, weights.shape
    for r in range(part.first, part.end):
        for c in range(len(source)):
            for x in range(count):
                s = np.float32(0.0)
                for t in range(taps):
                    s += weights[x, t] * source[c, r, min(first[x] + t, last)]
                out[c, r, x] = s


def average_columns(source: FloatArray, first: IntArray, weights: FloatArray, rows: range | None = None) -> FloatArray:
    """Average a source over footprints along x: ``out[x] = sum over t of weights[x, t] * source[first[x] + t]``.

    Args:
        source: (C, H, W) float32, linear light.
        first: (count,) first pixel of each footprint, see ``rasters.footprints``.
        weights: (count, taps) float32.
        rows: those of the source that are wanted; all by default.

    Returns:
        (C, H, count) float32, linear light; 0 in other rows.
    """
    out = np.zeros((*source.shape[:2], len(weights)), np.float32)
    in_threads(_average_columns_part, rows or source.shape[1], source, first, weights, out)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _display_rows_part(part, columns, first, weights, table, out):
    """Part of the rows, see ``display_rows``."""
    channels, last, width = len(columns), columns.shape[1] - 1, columns.shape[2]
    taps, skip = weights.shape[1], out.shape[1]
    line = np.zeros(width, np.float32)
    for y in range(part.first, part.end):
        for c in range(channels):
            line[:] = 0.0
            for t in range(taps):
                w, r = weights[y, t], min(first[y] + t, last)
                for x in range(width):
                    line[x] += w * columns[c, r, x]
            for phase in range(skip):
                for n in range((width - phase + skip - 1) // skip):
                    k = int(line[n * skip + phase] * np.float32(len(table) - 1) + np.float32(0.5))
                    out[c, phase, y, n] = table[min(max(k, 0), len(table) - 1)]


def display_rows(
    columns: FloatArray, first: IntArray, weights: FloatArray, table: FloatArray, skip: int, rows: range
) -> FloatArray:
    """Average columns over footprints along y, and turn light into display values.

    Args:
        columns: (C, H, X) float32, linear light.
        first: (count,) first row of each footprint, see ``rasters.footprints``.
        weights: (count, taps) float32.
        table: display values of evenly spaced linear light from 0 to 1.
        skip: number of phases into which rows are split.
        rows: those of the result that are wanted.

    Returns:
        (C, skip, count, X / skip) float32 display values: sample (y, x) at [:, x % skip, y, x // skip]; 0 in other
        rows.
    """
    channels, _, width = columns.shape
    out = np.zeros((channels, skip, len(weights), -(-width // skip)), np.float32)
    in_threads(_display_rows_part, rows, columns, first, weights, table, out)
    return out


@njit(cache=True, fastmath={"contract", "reassoc"})
def _add_up(weights, k, lines, step, out):
    """``out[n] = sum over m of weights[k, m] * lines[m * step + n]``."""
    terms, count = weights.shape[1], np.uint64(len(out))
    fours = terms - terms % 4
    for n in range(count):
        out[n] = 0.0
    for m in range(0, fours, 4):
        w0, w1, w2, w3 = weights[k, m], weights[k, m + 1], weights[k, m + 2], weights[k, m + 3]
        a0, a1 = np.uint64(m * step), np.uint64((m + 1) * step)
        a2, a3 = np.uint64((m + 2) * step), np.uint64((m + 3) * step)
        for n in range(count):
            out[n] += (w0 * lines[a0 + n] + w1 * lines[a1 + n]) + (w2 * lines[a2 + n] + w3 * lines[a3 + n])
    for m in range(fours, terms):
        w, a = weights[k, m], np.uint64(m * step)
        for n in range(count):
            out[n] += w * lines[a + n]


@njit(cache=True)
def kept_of_energy(vectors):
    """What is left of sums of squares, so that rounding never makes a bound larger than a difference."""
    return 1.0 - 2.0**-23 * (vectors + 8)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _features_part(part, samples, skip_y, places, basis, features):
    """Part of the rows of features, see ``patch_features``; places: where they begin, along y and in a flat line."""
    channels, skip, _, width = samples.shape
    pixels, (at_y, at_x), line = len(basis.waves), places, skip * width
    zero, one = np.int64(0), np.int64(1)  # numba would compile a function apart for literals
    # waves along y of all rows of a patch, mixtures of channels, waves along x: one after the other
    rows, waved = np.empty((pixels, line)), np.empty((pixels, channels, line))
    mixed, out, squares = np.empty(line + pixels), np.empty(line), np.empty(line + pixels)
    left, ones, kept = np.empty(len(at_x)), np.ones((1, pixels)), kept_of_energy(len(basis.vectors))
    mixed[:], squares[:] = 0.0, 0.0
    needed = np.zeros((pixels, channels), np.bool_)
    for m in range(len(basis.vectors)):
        needed[basis.vectors[m, 1], basis.vectors[m, 0]] = True
    for j in range(part.first, part.end):
        squares[:] = 0.0
        for c in range(channels):
            for k in range(pixels):
                for phase in range(skip):
                    for n in range(width):
                        value = np.float64(samples[c, phase, at_y[j] + k * skip_y, n] - GREY)
                        rows[k, phase * width + n] = value
                        squares[phase * width + n] += value * value
            for wave in range(pixels):
                if needed[wave].any():
                    _add_up(basis.waves, wave, rows.reshape(-1), line, waved[wave, c])
        _add_up(ones, zero, squares, one, out)
        for i in range(len(at_x)):
            left[i] = out[at_x[i]]
            features[j, 0, i] = left[i] * kept
        for wave in range(pixels):
            for mixture in range(channels):
                if needed[wave, mixture]:
                    _add_up(basis.mixtures, mixture, waved[wave].reshape(-1), line, mixed[:line])
                for m in range(len(basis.vectors)):
                    if basis.vectors[m, 0] == mixture and basis.vectors[m, 1] == wave:
                        _add_up(basis.waves, basis.vectors[m, 2], mixed, one, out)
                        for i in range(len(at_x)):
                            value = out[at_x[i]]
                            features[j, m + 2, i] = value
                            left[i] -= value * value
        for i in range(len(at_x)):
            features[j, 1, i] = math.sqrt(max(left[i], 0.0))


def patch_features(
    samples: FloatArray, skip_y: int, strides: tuple[int, int], basis: Basis, rows: range | None = None
) -> FloatArray:
    """What bounds know of the patches that begin at every so many samples.

    Args:
        samples: (C, skip, Y, X / skip) float32 display values, see ``display_rows``.
        skip_y: samples between two neighbouring pixels of a patch along y.
        strides: samples between two neighbouring patches along y and x.
        basis: n vectors over the pixels of a patch.
        rows: of samples; patches that leave them are not wanted. All by default.

    Returns:
        (Y / sy, n + 2, X / sx) float32, without the places where a patch would leave the raster; 0 for patches that are
        not wanted. Of a patch's values, less GREY: the sum of squares, see ``kept_of_energy``, its coordinates along
        the vectors, after the norm of what these leave out. The last EIGHT columns are there to be read with others.
    """
    _, skip, height, width = samples.shape
    pixels, reach = len(basis.waves), (len(basis.waves) - 1) * skip_y
    y = np.arange(0, max(height - reach, 0), strides[0])
    rows = rows or range(height)
    wanted = range(-(-rows.start // strides[0]), max(rows.stop - reach - 1, -1) // strides[0] + 1)
    x = np.arange(0, max((width - pixels + 1) * skip, 0), strides[1])
    features = np.zeros((len(y), len(basis.vectors) + 2, len(x) + EIGHT), np.float32)
    in_threads(_features_part, wanted, samples, skip_y, (y, x % skip * width + x // skip), basis, features)
    return features
