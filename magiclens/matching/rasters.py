"""The source resampled so that a magnified tile's pixels fall on whole raster samples.

For a map diag(+-a, +-b) the P x P pixels of a tile, spaced by ``px``, see source points spaced by (a px, b px), each
averaged over its (a px) x (b px) footprint. A raster whose spacing divides these makes every sample a table
look-up, so that the search below is exact, without interpolation. All four signs share one raster.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.images import to_display
from magiclens.matching.features import Basis, choose_basis
from magiclens.matching.raster_kernels import display_rows, patch_features

DISPLAY_TABLE = to_display(np.linspace(0.0, 1.0, 8192)).astype(np.float32)
"""Display values of evenly spaced linear light, for kernels to look up."""


@dataclass(frozen=True)
class RasterAxis:
    """One axis of a raster: sample r lies at ``(r - (count - 1) / 2) * spacing_mm``.

    Args:
        spacing_mm: distance between neighbouring samples.
        count: how many samples there are.
        skip: how many samples separate two neighbouring tile pixels.
        stride: how many samples separate two neighbouring offsets.
    """

    spacing_mm: float
    count: int
    skip: int
    stride: int

    def positions_mm(self) -> FloatArray:
        """(count,) float64: where the samples lie, from the middle of the source."""
        return (np.arange(self.count) - (self.count - 1) / 2) * self.spacing_mm

    def within(self, first_mm: float, last_mm: float) -> range:
        """The samples between two places, and a stride more on either side; the nearest sample if there is none."""
        first, last = (mm / self.spacing_mm + (self.count - 1) / 2 for mm in (first_mm, last_mm))
        start = min(max(math.floor(first) - self.stride, 0), self.count - 1)
        return range(start, max(min(math.ceil(last) + self.stride + 1, self.count), start + 1))


class Raster(NamedTuple):
    """A raster as the search takes it: for one pair of map magnitudes along x and y, and all four signs of these.

    Args:
        samples: (C, skip_x, Y, X) float32 display values, see ``build_raster``.
        basis: what bounds know of a tile or patch.
        features: of the patches, EIGHT by EIGHT, see ``patch_features``.
        scale_x, scale_y: magnitudes of the map.
        spacing_x, spacing_y: distance between neighbouring samples, mm.
        count_x, count_y: how many samples there are.
        skip_x, skip_y: how many samples separate two neighbouring tile pixels.
        stride_x, stride_y: how many samples separate two neighbouring patches.
    """

    samples: FloatArray
    basis: Basis
    features: IntArray
    scale_x: float
    scale_y: float
    spacing_x: float
    spacing_y: float
    count_x: int
    count_y: int
    skip_x: int
    skip_y: int
    stride_x: int
    stride_y: int


def raster_axis(scale: float, px_mm: float, step_mm: float, size_mm: float) -> RasterAxis:
    """The raster axis on which tile pixels and offsets are whole numbers of samples apart.

    Args:
        scale: magnitude of the map along the axis.
        px_mm: side of a tile's pixel.
        step_mm: distance between offsets, at most.
        size_mm: side of the source.
    """
    seen = scale * px_mm
    skip = max(1, round(seen / step_mm))
    spacing = seen / skip
    stride = max(1, int(step_mm / spacing + 1e-9))
    return RasterAxis(spacing, int((size_mm - seen) / spacing) + 1, skip, stride)


def footprints(axis: RasterAxis, width_mm: float, size_mm: float, pixels: int) -> tuple[IntArray, FloatArray]:
    """The pixels over which a source is averaged around each position of a raster axis.

    Args:
        axis: the axis.
        width_mm: width of the average.
        size_mm: width of the source.
        pixels: of the source along the axis.

    Returns:
        (count,) first source pixel, and (count, taps) float32 weights of the pixels from there on.
    """
    per_mm = pixels / size_mm
    lo = (axis.positions_mm() - width_mm / 2 + size_mm / 2) * per_mm
    hi = lo + width_mm * per_mm
    first = np.clip(np.floor(lo + 1e-9).astype(np.int64), 0, pixels - 1)
    taps = int(np.ceil(width_mm * per_mm)) + 1
    k = first[:, None] + np.arange(taps)
    weights = np.clip(np.minimum(hi[:, None], k + 1) - np.maximum(lo[:, None], k), 0, None) * (k < pixels)
    return first, (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


def build_raster(
    columns: FloatArray, first: IntArray, weights: FloatArray, x: RasterAxis, y: RasterAxis, pixels: int,
    rows: range | None = None,
) -> tuple[FloatArray, Basis, IntArray]:  # fmt: skip
    """Average columns over their footprints along y, too, and lay the samples out for the search.

    Sample (r_y, r_x) of the plain raster sits at [:, r_x % skip, r_y, r_x // skip], with the skip along x, so that the
    pixels of a tile's row are neighbours in memory.

    Args:
        columns: (C, H, x.count) float32, linear light: the source averaged along x.
        first: (y.count,) first source pixel of each footprint along y.
        weights: (y.count, taps) of the pixels from there on.
        x, y: the raster's axes.
        pixels: P, along a tile's side.
        rows: those of the samples that are wanted; all by default.

    Returns:
        Samples (C, x.skip, y.count, X), float32 display values, a basis for their patches, and the ``patch_features``.
    """
    rows = rows or range(y.count)
    samples = display_rows(columns, first, weights, DISPLAY_TABLE, x.skip, rows)
    basis = choose_basis(samples[:, :, rows.start : rows.stop], y.skip, pixels)
    return samples, basis, patch_features(samples, y.skip, (y.stride, x.stride), basis, rows)
