"""The source resampled so that a magnified tile's pixels fall on whole raster samples.

For a map diag(+-a, +-b) the P x P pixels of a tile, spaced by ``px``, see source points spaced by (a px, b px), each
averaged over its (a px) x (b px) footprint. A raster whose spacing divides these makes every sample a table
look-up, so that the search below is exact, without interpolation. All four signs share one raster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.images import to_display

DISPLAY = to_display(np.linspace(0.0, 1.0, 8192)).astype(np.float32)
"""Display values of evenly spaced linear light, for kernels to look up."""
BLOCK = 4
"""Tile pixels per side of a block whose mean bounds the squared difference from below."""


@dataclass(frozen=True)
class Axis:
    """One axis of a raster: sample r lies at ``(r - (count - 1) / 2) * spacing_mm``.

    ``skip`` samples separate two neighbouring tile pixels, ``stride`` samples separate two neighbouring offsets.
    """

    spacing_mm: float
    count: int
    skip: int
    stride: int

    def positions_mm(self) -> FloatArray:
        """(count,) float64."""
        return (np.arange(self.count) - (self.count - 1) / 2) * self.spacing_mm


def axis(scale: float, px_mm: float, step_mm: float, size_mm: float) -> Axis:
    """The raster axis for tile pixels of ``px_mm`` seen at ``scale``, offsets every ``step_mm`` or finer."""
    seen = scale * px_mm
    skip = max(1, round(seen / step_mm))
    spacing = seen / skip
    stride = max(1, int(step_mm / spacing + 1e-9))
    return Axis(spacing, int((size_mm - seen) / spacing) + 1, skip, stride)


def footprints(axis: Axis, width_mm: float, size_mm: float, pixels: int) -> tuple[IntArray, FloatArray]:
    """First source pixel and weights (count, taps) of the average over ``width_mm`` around each raster position."""
    per_mm = pixels / size_mm
    lo = (axis.positions_mm() - width_mm / 2 + size_mm / 2) * per_mm
    hi = lo + width_mm * per_mm
    first = np.clip(np.floor(lo + 1e-9).astype(np.int64), 0, pixels - 1)
    taps = int(np.ceil(width_mm * per_mm)) + 1
    k = first[:, None] + np.arange(taps)
    weights = np.clip(np.minimum(hi[:, None], k + 1) - np.maximum(lo[:, None], k), 0, None) * (k < pixels)
    return first, (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


def average_columns(source: FloatArray, first: IntArray, weights: FloatArray) -> FloatArray:
    """(C, H, W) -> (C, H, count): footprint averages along x, linear light."""
    averages: FloatArray = _average_columns(source, first, weights)
    return averages


def build(columns: FloatArray, first: IntArray, weights: FloatArray, x: Axis, y: Axis) -> tuple[FloatArray, FloatArray]:
    """Display-value raster and its block means, both (C, y.stride, x.stride, Y, X), split by phase.

    Sample (r_y, r_x) of the plain raster sits at [:, r_y % sy, r_x % sx, r_y // sy, r_x // sx], so that neighbouring
    offsets are neighbours in memory. A block mean averages BLOCK x BLOCK tile pixels from that sample on.
    """
    shape = (columns.shape[0], y.stride, x.stride, -(-y.count // y.stride), -(-x.count // x.stride))
    raster = np.zeros(shape, np.float32)
    plain = _display_rows(columns, first, weights, DISPLAY)
    _split(plain, raster)
    blocks = np.zeros(shape, np.float32)
    _split(_block_means(plain, y.skip, x.skip), blocks)
    return raster, blocks


@njit(cache=True, parallel=True, fastmath=True)
def _average_columns(source, first, weights):
    channels, rows, _ = source.shape
    count, taps = weights.shape
    out = np.zeros((channels, rows, count), np.float32)
    last = source.shape[2] - 1
    for cr in prange(channels * rows):
        c, r = cr // rows, cr % rows
        for x in range(count):
            s = np.float32(0.0)
            for t in range(taps):
                s += weights[x, t] * source[c, r, min(first[x] + t, last)]
            out[c, r, x] = s
    return out


@njit(cache=True, parallel=True, fastmath=True)
def _display_rows(columns, first, weights, table):
    channels, rows, width = columns.shape
    count, taps = weights.shape
    out = np.zeros((channels, count, width), np.float32)
    for cy in prange(channels * count):
        c, y = cy // count, cy % count
        line = np.zeros(width, np.float32)
        for t in range(taps):
            w, r = weights[y, t], min(first[y] + t, rows - 1)
            for x in range(width):
                line[x] += w * columns[c, r, x]
        for x in range(width):
            k = int(line[x] * np.float32(len(table) - 1) + np.float32(0.5))
            out[c, y, x] = table[min(max(k, 0), len(table) - 1)]
    return out


@njit(cache=True, parallel=True, fastmath=True)
def _block_means(plain, skip_y, skip_x):
    channels, rows, width = plain.shape
    out = np.zeros_like(plain)
    span_y, span_x = (BLOCK - 1) * skip_y, (BLOCK - 1) * skip_x
    for cy in prange(channels * max(rows - span_y, 0)):
        c, y = cy // (rows - span_y), cy % (rows - span_y)
        line = np.zeros(width, np.float32)
        for k in range(BLOCK):
            for x in range(width):
                line[x] += plain[c, y + k * skip_y, x]
        for x in range(width - span_x):
            s = np.float32(0.0)
            for k in range(BLOCK):
                s += line[x + k * skip_x]
            out[c, y, x] = s * np.float32(1.0 / (BLOCK * BLOCK))
    return out


@njit(cache=True, parallel=True)
def _split(plain, out):
    channels, rows, width = plain.shape
    sy, sx = out.shape[1], out.shape[2]
    for cy in prange(channels * rows):
        c, y = cy // rows, cy % rows
        for phase in range(sx):
            line, from_ = out[c, y % sy, phase, y // sy], plain[c, y, phase:]
            for k in range((width - phase + sx - 1) // sx):
                line[k] = from_[k * sx]
