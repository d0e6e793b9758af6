"""The form of a coupon: gratings, pyramids, lenslets and flats, in a continuous top."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, Solid
from magiclens.geometry.solid import solid_from_raster
from magiclens.profiles.machines import Printer

WIDTH_MM, DEPTH_MM = 40.0, 30.0
"""Sides of the coupon, along x and along y."""
CELL_MM, _PITCH_MM = 6.0, 6.2
"""Side of a feature, and the distance between the centres of two."""
_LEVEL_MM = 3.2
"""Least height of what is flat: all printers make the features' lowest places then."""
_GABLE = 0.08
"""Slope of the roofs that gratings lie on: along a grating, its heights fall on all parts of a layer in turn, so that
rounding to layers keeps its mean height."""
_STEP_MM = 0.1
"""Distance of the mesh's vertices."""
_SECONDS_PER_LAYER = 7.0
"""What a consumer's resin printer takes: 2 seconds of light and 5 of lifting. An estimate."""


class Grating(NamedTuple):
    """Waves on a gentle roof; ``slope`` is that of the wave where it is steepest, ``across`` if it runs along y."""

    wavelength_mm: float
    slope: float
    across: bool = False

    def rise(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Height above the flats at (u, v) from the cell's centre, mm."""
        if self.across:
            u, v = v, u
        amplitude = self.slope * self.wavelength_mm / (2 * math.pi)
        waves: FloatArray = amplitude * np.sin(2 * math.pi * (u + CELL_MM / 2) / self.wavelength_mm)
        return waves + _GABLE * (CELL_MM / 2 - np.abs(v))


class Pyramid(NamedTuple):
    """Four wedges, which meet in straight edges."""

    slope: float

    def rise(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """See ``Grating``."""
        return self.slope * (CELL_MM / 2 - np.maximum(np.abs(u), np.abs(v)))


class Cap(NamedTuple):
    """A spherical lenslet."""

    radius_mm: float

    def rise(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """See ``Grating``."""
        edge = (CELL_MM / 2) ** 2
        out: FloatArray = np.sqrt(self.radius_mm**2 - np.minimum(u * u + v * v, edge))
        return out - math.sqrt(self.radius_mm**2 - edge)


class Plateau(NamedTuple):
    """Nothing: a place as high as the rim."""

    def rise(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """See ``Grating``."""
        return np.zeros_like(u)


Feature = Grating | Pyramid | Cap | Plateau
"""What one cell of a coupon holds."""

FEATURES: tuple[tuple[Feature, ...], ...] = (
    tuple(Grating(w, s) for w, s in ((0.4, 0.15), (0.6, 0.2), (0.75, 0.2), (1.0, 0.25), (1.5, 0.25), (3.0, 0.3))),
    tuple(
        Grating(w, s, True) for w, s in ((0.4, 0.1), (0.6, 0.12), (0.75, 0.12), (1.0, 0.15), (1.5, 0.15), (2.0, 0.2))
    ),
    (Pyramid(0.3), Cap(8.0), Pyramid(0.15), Plateau(), Cap(12.0), Pyramid(0.25)),
    tuple(Grating(w, s) for w, s in ((0.5, 0.3), (0.6, 0.35), (0.75, 0.4), (1.0, 0.4), (1.5, 0.4), (2.0, 0.4))),
)
"""Rows of features, the first at +y. Wavelengths divide a cell's side."""


def coupon_solid(layer_mm: float) -> Solid:
    """The coupon as it is designed, centred, its flat bottom at z = 0; its flats are whole layers high."""
    x, y = (np.linspace(-s / 2, s / 2, round(s / _STEP_MM) + 1) for s in (WIDTH_MM, DEPTH_MM))
    return solid_from_raster(x, y[::-1], _heights(*np.meshgrid(x, y[::-1]), layer_mm))


def off_borders(x_mm: FloatArray, y_mm: FloatArray, margin_mm: float) -> BoolArray:
    """Whether points of the top lie inside the rim, and away from the ends of gratings, which are small steps."""
    rim = np.minimum(WIDTH_MM / 2 - np.abs(x_mm), DEPTH_MM / 2 - np.abs(y_mm))
    beside = np.full(np.shape(x_mm), np.inf)
    for feature, u, v in _cells(x_mm, y_mm):
        if isinstance(feature, Grating):
            beside = np.minimum(beside, np.abs(CELL_MM / 2 - np.maximum(np.abs(u), np.abs(v))))
    return np.asarray((rim > 4 * margin_mm) & (beside > margin_mm))


def printing_minutes(solid: Solid, printer: Printer) -> float:
    """How long a consumer's resin printer takes, by its number of layers; an estimate."""
    return math.ceil(float(solid.vertices[:, 2].max()) / printer.layer) * _SECONDS_PER_LAYER / 60


def features_data() -> list[dict[str, Any]]:
    """What is where, for the manifest."""
    return [
        {"feature": type(f).__name__.lower(), "centre_mm": _centre(row, column), **f._asdict()}
        for row, features in enumerate(FEATURES)
        for column, f in enumerate(features)
    ]


def _heights(x: FloatArray, y: FloatArray, layer_mm: float) -> FloatArray:
    z = np.full(x.shape, math.ceil(_LEVEL_MM / layer_mm - 1e-9) * layer_mm)
    for feature, u, v in _cells(x, y):
        inside = np.maximum(np.abs(u), np.abs(v)) <= CELL_MM / 2 + 1e-9
        z[inside] += feature.rise(u[inside], v[inside])
    return z


def _cells(x: FloatArray, y: FloatArray) -> list[tuple[Feature, FloatArray, FloatArray]]:
    """Every feature, with the points as they lie to its centre."""
    out = []
    for row, features in enumerate(FEATURES):
        for column, feature in enumerate(features):
            cx, cy = _centre(row, column)
            out.append((feature, x - cx, y - cy))
    return out


def _centre(row: int, column: int) -> tuple[float, float]:
    rows, columns = len(FEATURES), len(FEATURES[0])
    return round((column - (columns - 1) / 2) * _PITCH_MM, 6), round(((rows - 1) / 2 - row) * _PITCH_MM, 6)
