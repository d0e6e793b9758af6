"""The top as a picture of heights, for milling programs and for measuring."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Exporter
from magiclens.contract.units import LENGTH, Length

_WHITE = 65535
"""Grey value of the highest point."""
_MOST_PIXELS = 16384
"""Most pixels per side; more need more memory than a desktop has."""


class HeightMap(Exporter):
    """The top's height over the lens's square, seen straight down, as a 16-bit grey PNG: white is highest.

    Every pixel has the height of the surface at its centre. Beside it, ``lens.heightmap.json`` says what a grey value
    is in millimetres. Row 0 is at +y, as the viewer sees the lens.
    """

    type: ClassVar[str] = "heightmap"
    suffix: ClassVar[str] = ".heightmap.png"

    pixel: Length = Field("0.05mm", validate_default=True, ge=0.0001, le=1000, description="side of a pixel, about")

    def require_possible(self, lens: Lens) -> None:
        """Pixels must be neither too many nor too large."""
        self._side(lens.size_mm)

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the picture, and what it means beside it. Raises InputError if pixels are too many or too large."""
        from magiclens.geometry.columns import top_heights

        lens = scene.lens
        side = self._side(lens.size_mm)
        pixel_mm = lens.size_mm / side
        x = (np.arange(side) + 0.5) * pixel_mm - lens.size_mm / 2
        z = top_heights(solid, x, -x)
        low, high = (float(bound) for bound in (np.nanmin(z), np.nanmax(z)))
        low = min(low, high - 0.001)  # a flat top has a range too
        _write(z, low, high, path, pixel_mm)
        meaning = json.dumps(_meaning(scene, side, low, high), indent=2)
        path.with_suffix(".json").write_text(meaning + "\n", encoding="utf-8")

    def _side(self, size_mm: float) -> int:
        """Number of pixels per side: the lens is divided evenly, into pixels about as large as wanted."""
        side = round(size_mm / self.pixel)
        if 2 <= side <= _MOST_PIXELS:
            return side
        # 5e-5 rounds up to four decimals, so that the pixel that is proposed is not too small again
        near = LENGTH.text(size_mm / 2 if side < 2 else round(size_mm / _MOST_PIXELS + 5e-5, 4))
        wish = f"'{LENGTH.text(self.pixel)}' gives {side} x {side} pixels; 2 to {_MOST_PIXELS} per side are possible"
        raise InputError(f"{wish}, the nearest is '{near}'", keys=("pixel",))


def _write(z: FloatArray, low: float, high: float, path: Path, pixel_mm: float) -> None:
    """Write heights (rows, columns), mm, as greys from ``low``, black, to ``high``, white; NaN (no solid) is black."""
    from PIL import Image

    greys = np.rint((np.nan_to_num(z, nan=low) - low) * (_WHITE / (high - low))).astype(np.uint16)
    Image.fromarray(greys).save(path, format="PNG", dpi=(25.4 / pixel_mm,) * 2)


def _meaning(scene: Scene, side: int, low: float, high: float) -> dict[str, Any]:
    """What pixels and grey values are in millimetres."""
    lens = scene.lens
    return {
        "format": "magiclens height map",
        "unit": "mm",
        "size_mm": [lens.size_mm, lens.size_mm],
        "pixels": [side, side],
        "pixel_mm": lens.size_mm / side,
        "z_at_0_mm": low,
        "z_at_65535_mm": high,
        "thickness_mm": lens.thickness_mm,
        "order": "rows from +y down, columns from -x on, values at the centres of pixels",
    }
