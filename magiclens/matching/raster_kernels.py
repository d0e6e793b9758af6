"""Kernels that resample the source, see ``rasters``."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.eights import EIGHT
from magiclens.kernels.threads import in_threads
from magiclens.kernels.uncounted import uncounted
from magiclens.matching.features import FARTHEST, GREY, LOW_BITS, Basis

_TALL, _WIDE = 16, 128
"""Patches along y and x whose features are computed together, so that what they need stays at hand."""


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
def _add_up(weights, lines, start, step, out):
    """``out[n] = sum over m of weights[m] * lines[start + m * step + n]``."""
    terms, count, a = len(weights), np.uint64(len(out)), np.uint64(start)
    for n in range(count):
        out[n] = 0.0
    for m in range(0, terms - terms % 4, 4):
        w0, w1, w2, w3 = weights[m], weights[m + 1], weights[m + 2], weights[m + 3]
        a0, a1, a2, a3 = a, a + np.uint64(step), a + np.uint64(2 * step), a + np.uint64(3 * step)
        for n in range(count):
            out[n] += (w0 * lines[a0 + n] + w1 * lines[a1 + n]) + (w2 * lines[a2 + n] + w3 * lines[a3 + n])
        a += np.uint64(4 * step)
    for m in range(terms - terms % 4, terms):
        for n in range(count):
            out[n] += weights[m] * lines[a + n]
        a += np.uint64(step)


@njit(cache=True, fastmath={"contract", "reassoc"})
def _mix(samples, origin, basis, mixed, squares):
    """Mixtures of channels (C, rows, columns) of a rectangle of samples, and the sums of their squares.

    Args:
        samples: (C, skip, Y, X), see ``display_rows``.
        origin: phase, row and column of the first; what lies beyond the samples is 0.
        basis: says which mixtures are wanted.
        mixed, squares: to fill in.
    """
    channels, _, height, width = samples.shape
    (phase, top, left), (rows, columns) = origin, squares.shape
    values, inside, one = np.zeros((channels, columns)), min(columns, width - left), np.int64(1)
    wanted, zero = np.zeros(channels, np.bool_), np.int64(0)
    for m in range(len(basis.vectors)):
        wanted[basis.vectors[m, 0]] = True
    for y in range(min(rows, height - top)):
        for c in range(channels):
            for n in range(inside):
                values[c, n] = np.float64(samples[c, phase, top + y, left + n] - GREY)
            for n in range(columns):
                squares[y, n] = values[c, n] * values[c, n] + (squares[y, n] if c else 0.0)
        for m in range(channels):
            if wanted[m]:
                _add_up(basis.mixtures[m], values.reshape(-1), zero, columns * one, mixed[m, y])


@njit(cache=True)
def in_steps(value, basis):
    """A coordinate in steps, of which none is farther than the farthest from 0."""
    return np.int32(min(max(np.rint(value * basis.steps), -FARTHEST), FARTHEST))


@njit(cache=True, fastmath={"contract", "reassoc"})
def _coordinates(mixed, squares, row, skip_y, basis, lines, numbers):
    """What is known of the patches that begin at a row of ``_mix``.

    Args:
        mixed, squares: see ``_mix``.
        row: of these.
        skip_y: samples between two neighbouring pixels of a patch along y.
        basis: of the patches.
        lines: (3, columns of ``mixed``) float64, to compute with.
        numbers: (numbers, columns) int16: see ``Basis``, to fill in.
    """
    columns, one, zero = numbers.shape[1], np.int64(1), np.int64(0)
    start, step = row * mixed.shape[2], skip_y * mixed.shape[2]
    waved, left, out = lines[0], lines[1, :columns], lines[2, :columns]
    ones, energies = np.ones(len(basis.waves)), np.zeros(columns, np.int32)
    _add_up(ones, squares.reshape(-1), start, step, waved)
    _add_up(ones, waved, zero, one, left)
    for mixture in range(len(mixed)):
        for wave in range(len(basis.waves)):
            ready = False
            for m in range(len(basis.vectors)):
                if basis.vectors[m, 0] == mixture and basis.vectors[m, 1] == wave:
                    if not ready:
                        _add_up(basis.waves[wave], mixed[mixture].reshape(-1), start, step, waved)
                        ready = True
                    _add_up(basis.waves[basis.vectors[m, 2]], waved, zero, one, out)
                    _put(out, basis, numbers[basis.places[m]], energies)
                    for n in range(columns):
                        left[n] -= out[n] * out[n]
    for n in range(columns):
        out[n] = math.sqrt(max(left[n], 0.0))
    _put(out, basis, numbers[2], energies)
    for n in range(columns):
        numbers[0, n], numbers[1, n] = energies[n] >> LOW_BITS, energies[n] & ((1 << LOW_BITS) - 1)


@njit(cache=True)
def _put(values, basis, numbers, energies):
    """Values in steps, and their squares added to energies."""
    for n in range(len(values)):
        number = in_steps(values[n], basis)
        numbers[n] = number
        energies[n] += number * number


@njit(cache=True)
def _lay_out(numbers, places, left, row, features):
    """Copy what is known of patches to where the search reads it.

    Args:
        numbers: (numbers, columns) int16, of samples.
        places: (patches, 2) which of these the patches begin at, counted from further left, and which patches they are.
        left: how much further left.
        row: of patches.
        features: to fill in.
    """
    flat, (_, rows, pairs, _, _) = features.reshape(-1), features.shape
    lanes, one = np.uint64(2 * EIGHT), np.uint64(1)
    for p in range(len(places)):
        n, i = np.uint64(places[p, 0] - left), places[p, 1]
        at = np.uint64(((i // EIGHT * rows + row) * pairs * EIGHT + i % EIGHT) * 2)
        for k in range(np.uint64(0), np.uint64(2 * pairs), np.uint64(2)):
            flat[at], flat[at + one] = numbers[k, n], numbers[k + one, n]
            at += lanes


@njit(cache=True, nogil=True)
def _features_part(part, samples, skip_y, strides, basis, features):
    """Part of the bands of _TALL rows of patches, see ``patch_features``; each rectangle of samples stays at hand."""
    (channels, skip, _, width), (stride_y, stride_x), pixels = samples.shape, strides, len(basis.waves)
    samples, basis, features = uncounted(samples), uncounted(basis), uncounted(features)
    _, rows, pairs, _, _ = features.shape
    tall, wide = (_TALL - 1) * stride_y + (pixels - 1) * skip_y + 1, _WIDE + pixels
    mixed, squares = np.zeros((channels, tall, wide)), np.zeros((tall, wide))
    lines, numbers = np.zeros((3, wide)), np.zeros((2 * pairs, _WIDE), np.int16)
    places = np.empty((_WIDE, 2), np.int64)
    for band in range(part.first, part.end):
        for phase in range(skip):
            for left in range(0, width - pixels + 1, _WIDE):
                count, end = 0, min(left + _WIDE, width - pixels + 1)
                for i in range((left * skip + phase + stride_x - 1) // stride_x, (end * skip - 1) // stride_x + 1):
                    if i * stride_x % skip == phase:
                        places[count, 0], places[count, 1] = i * stride_x // skip, i
                        count += 1
                if count == 0:
                    continue
                _mix(samples, (phase, band * _TALL * stride_y, left), basis, mixed, squares)
                for j in range(band * _TALL, min((band + 1) * _TALL, rows)):
                    _coordinates(mixed, squares, (j - band * _TALL) * stride_y, skip_y, basis, lines, numbers)
                    _lay_out(numbers, places[:count], left, j, features)


def patch_features(
    samples: FloatArray, skip_y: int, strides: tuple[int, int], basis: Basis, rows: range | None = None
) -> IntArray:
    """What bounds know of the patches that begin at every so many samples.

    Args:
        samples: (C, skip, Y, X / skip) float32 display values, see ``display_rows``.
        skip_y: samples between two neighbouring pixels of a patch along y.
        strides: samples between two neighbouring patches along y and x.
        basis: n vectors over the pixels of a patch.
        rows: of samples; patches that leave them are not wanted. All by default.

    Returns:
        (X / sx / EIGHT, Y / sy, pairs, EIGHT, 2) int16: the numbers of patches, see ``Basis``, EIGHT by EIGHT, without
        the places where a patch would leave the raster. Those of patches that are not wanted, and of the last EIGHT
        beyond the raster, have no meaning.
    """
    _, skip, height, width = samples.shape
    pixels, reach = len(basis.waves), (len(basis.waves) - 1) * skip_y
    y = range(0, max(height - reach, 0), strides[0])
    x = range(0, max((width - pixels + 1) * skip, 0), strides[1])
    rows = rows or range(height)
    bands = range(rows.start // strides[0] // _TALL, max(rows.stop - reach - 1, -1) // strides[0] // _TALL + 1)
    shape = -(-len(x) // EIGHT), len(y), int(basis.ends[-1]), EIGHT, 2
    room = np.zeros(math.prod(shape) + 32, np.int16)
    features = room[-room.ctypes.data % 64 // 2 :][: math.prod(shape)].reshape(shape)
    in_threads(_features_part, bands, samples, skip_y, strides, basis, features)
    return features
