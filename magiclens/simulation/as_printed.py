"""The lens as a printer makes it: layers, material that spreads, a finish that evens out."""

from __future__ import annotations

import math
from collections.abc import Callable
from weakref import finalize

import numpy as np

from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.geometry.solid import solid_from_raster
from magiclens.processes.diffusion import diffusion_weights
from magiclens.processes.layers import layers_of_tops, tops_of
from magiclens.processes.linear import LinearProcess
from magiclens.profiles.machines import Printer

Columns = tuple[FloatArray, FloatArray, FloatArray]
"""(rows, columns) heights of columns of pixels, mm; (columns,) their x, ascending; (rows,) their y, descending, mm."""
_MOST_PIXELS, _MOST_POINTS = 40_000_000, 8_000_000
"""Most columns of pixels, which are joined on large lenses, and most points of the surface that is traced."""

_bodies: dict[int, tuple[Printer, Solid]] = {}
"""The last body of each solid by the solid's identity, for as long as somebody has the solid."""


def as_printed(solid: Solid, printer: Printer) -> Solid:
    """The body that a printer makes of a solid, layer by layer, at the printer's own pixels.

    A column of pixels gets layers by its height, see ``tops_of``. Material then spreads sideways, and the finish
    evens the surface out, see ``LinearProcess``. Undercuts fill with support and are lost. The grid's cells are
    vertical (``eye_mm`` is None), and the solid's sides are part of it. A part that is printed tilted is turned back
    before its finish; its flat side is taken as flat, see ``Printer.growth_mm``.

    Whoever asks again gets the same body: several analyses of a run look through it, and it takes seconds.
    """
    known = _bodies.get(id(solid))
    if known and known[0] == printer:
        return known[1]
    body = _finished(in_layers, solid, printer)
    if not known:
        finalize(solid, _bodies.pop, id(solid))
    _bodies[id(solid)] = printer, body
    return body


def without_layers(solid: Solid, printer: Printer) -> Solid:
    """The same for layers of no height: all that a printer does to a solid but rounding."""
    return _finished(_columns, solid, printer)


def _finished(columns_of: Callable[[Solid, Printer], Columns], solid: Solid, printer: Printer) -> Solid:
    if printer.tilt is None:
        return _evened(columns_of(solid, printer), printer.linear_process, _pixels(solid, printer))
    stood, tilt = printer.tilt.stood(solid), printer.tilt
    pixels = _pixels(stood, printer)
    z, x, y = columns_of(stood, printer)
    spread = printer.spreading.of(z, pixels) + tilt.lowest_mm(solid)
    axis = 1 if tilt.about == "x" else 0
    turned = _middles(solid, axis, pixels[axis])[2:-2]  # at either end, the outermost pixels have too little
    raster = (x, turned[::-1]) if axis == 1 else (turned, y)
    lying = np.maximum(tilt.lying(spread, x, y, raster), 0.0) + printer.growth_mm
    return _evened((lying, *raster), printer.finish, pixels)


def in_layers(solid: Solid, printer: Printer) -> Columns:
    """The top of a solid in layers, before anything evens it out."""
    z, x, y = _columns(solid, printer)
    weights = diffusion_weights(printer.linear_process, _pixels(solid, printer))
    tops = tops_of(z, printer.layer, printer.slicing, printer.shares, weights)
    return np.maximum(layers_of_tops(tops, printer.shares), 1) * printer.layer, x, y


def _columns(solid: Solid, printer: Printer) -> Columns:
    from magiclens.geometry.columns import top_heights

    x, y = (_middles(solid, axis, pixel) for axis, pixel in enumerate(_pixels(solid, printer)))
    return np.nan_to_num(top_heights(solid, x, y[::-1]), nan=0.0), x, y[::-1]


def _evened(columns: Columns, process: LinearProcess, pixels: tuple[float, float]) -> Solid:
    z, x, y = columns
    even = process.of(z, pixels)
    # the surface is smooth now: every second pixel says all of it
    every = math.ceil(math.sqrt(even.size / _MOST_POINTS))
    return solid_from_raster(x[::every], y[::every], np.ascontiguousarray(even[::every, ::every]))


def _pixels(solid: Solid, printer: Printer) -> tuple[float, float]:
    """Width and height of the columns: the printer's pixels, or as many of them joined as are needed."""
    width, height = np.ptp(solid.vertices[:, :2], axis=0)
    px, py = printer.pixels_mm
    joined = math.ceil(math.sqrt(max(width / px * height / py / _MOST_PIXELS, 1.0)))
    return px * joined, py * joined


def _middles(solid: Solid, axis: int, pixel: float) -> FloatArray:
    """Ascending middles of the pixels that lie in the solid's extent along an axis, symmetric about its middle."""
    low, high = float(solid.vertices[:, axis].min()), float(solid.vertices[:, axis].max())
    count = max(int((high - low) / pixel), 2)
    middles: FloatArray = (low + high) / 2 + (np.arange(count) - (count - 1) / 2) * pixel
    return middles
