"""The sources for a screen that the lens is laid on."""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Exporter
from magiclens.exporting.sources import distinct_sources
from magiclens.images.files import write_png

_MOST_PIXELS = 16384
"""Most pixels per side."""


class Monitor(Exporter):
    """The source at its physical size on a screen, pixel for pixel, resampled in linear light.

    Further sources of a scene stand beside it, as ``lens.monitor.<source>.png``.
    """

    type: ClassVar[str] = "monitor"
    suffix: ClassVar[str] = ".monitor.png"

    ppi: float = Field(ge=20, le=2000, description="pixels per inch of the screen; no default, as it sets the size")

    def require_possible(self, lens: Lens) -> None:
        """A screen cannot be larger than any."""
        self._side(lens.source_size_mm)

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the picture of each source. Raises InputError if a screen cannot be that large."""
        size_mm, pixel_mm = scene.lens.source_size_mm, 25.4 / self.ppi
        side = self._side(size_mm)
        for k, (name, source) in enumerate(distinct_sources(scene).items()):
            file = path if k == 0 else path.with_name(path.name.replace(".png", f".{name}.png"))
            write_png(file, resampled(source, side, size_mm / pixel_mm), 1 / pixel_mm)

    def _side(self, size_mm: float) -> int:
        """Number of pixels per side."""
        # less 1e-6: a source of a whole number of pixels must not get one more by rounding
        side = math.ceil(size_mm * self.ppi / 25.4 - 1e-6)
        if side > _MOST_PIXELS:
            wish = f"{size_mm:g} mm at {self.ppi:g} ppi are {side} pixels per side, more than {_MOST_PIXELS}"
            raise InputError(f"{wish}; use {int(25.4 * _MOST_PIXELS / size_mm)} or less", keys=("ppi",))
        return side


def resampled(linear: FloatArray, side: int, across: float) -> FloatArray:
    """A picture with other pixels, centred on white paper.

    Every new pixel is the exact mean of the light over its area, whether it is larger than the old ones or smaller.

    Args:
        linear: (H, W, C) linear light.
        side: new pixels per side of the paper.
        across: width of the picture in new pixels, at most ``side``; it need not be a whole number.

    Returns:
        (side, side, C) float32, linear light.
    """
    rows = _resampled_rows(linear, side, across)
    return np.ascontiguousarray(np.swapaxes(_resampled_rows(np.swapaxes(rows, 0, 1), side, across), 0, 1))


def _resampled_rows(image: FloatArray, side: int, across: float) -> FloatArray:
    """(side, ...) means over rows: differences of the running integral, which goes on with white (1) beside it.

    ``old`` is the number of old rows that a new one covers; ``edges`` are the borders of the new rows, counted in old
    ones.
    """
    old = len(image) / across
    edges = (np.arange(side + 1) - side / 2) * old + len(image) / 2
    within = np.clip(edges, 0, len(image))
    # float64: differences of large sums in float32 would lose the last bits of the light
    integral = np.zeros((len(image) + 1, *image.shape[1:]))
    np.cumsum(image, axis=0, out=integral[1:])
    below = np.minimum(within.astype(int), len(image) - 1)
    part = (within - below)[:, None, None]
    at_edges = integral[below] * (1 - part) + integral[below + 1] * part + (edges - within)[:, None, None]
    return np.asarray(np.diff(at_edges, axis=0) / old, np.float32)
