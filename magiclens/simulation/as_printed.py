"""The lens as a printer makes it: the stairs of its layers, material that spreads, polishing that evens out."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.geometry.solid import solid_from_raster
from magiclens.profiles.machines import Printer

_MOST_POINTS = 8_000_000
"""Most points of the printed surface; on large lenses pixels are joined to stay below."""


def as_printed(solid: Solid, printer: Printer) -> Solid:
    """The body that a printer makes of a solid, its top sampled at the printer's own pixels.

    A column of pixels gets as many layers as have their middle in the solid, as slicers do. Material then spreads
    sideways, and polishing or lacquer evens the surface out: Gaussians, which keep the volume. Undercuts fill with
    support and are lost. The grid's cells are vertical (``eye_mm`` is None), and the solid's sides are part of it.
    """
    from scipy.ndimage import gaussian_filter

    from magiclens.geometry.columns import top_heights

    x, y = (_middles(solid, axis, pixel) for axis, pixel in enumerate(_pixels(solid, printer)))
    z = np.nan_to_num(top_heights(solid, x, y[::-1]), nan=0.0).astype(np.float64)
    layers = np.maximum(np.rint(z / printer.layer), 1.0) * printer.layer
    # two Gaussians in a row are one whose variance is the sum of theirs
    spread = math.hypot(printer.blur, printer.polish)
    sigmas = spread / (y[1] - y[0]), spread / (x[1] - x[0])
    even = gaussian_filter(layers, sigmas, mode="nearest") if spread > 0 else layers
    return solid_from_raster(x, y[::-1], even)


def _pixels(solid: Solid, printer: Printer) -> tuple[float, float]:
    """Width and height of the samples: the printer's pixels, or as many of them joined as are needed."""
    width, height = np.ptp(solid.vertices[:, :2], axis=0)
    px, py = printer.pixels_mm
    joined = math.ceil(math.sqrt(max(width / px * height / py / _MOST_POINTS, 1.0)))
    return px * joined, py * joined


def _middles(solid: Solid, axis: int, pixel: float) -> FloatArray:
    """Ascending middles of the pixels that lie in the solid's extent along an axis, symmetric about its middle."""
    low, high = float(solid.vertices[:, axis].min()), float(solid.vertices[:, axis].max())
    count = max(int((high - low) / pixel), 2)
    middles: FloatArray = (low + high) / 2 + (np.arange(count) - (count - 1) / 2) * pixel
    return middles
