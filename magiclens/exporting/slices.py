"""A stack of pictures, one per layer, as printers that jet droplets take it."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar
from zipfile import ZipFile

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Exporter
from magiclens.contract.units import LENGTH, Length
from magiclens.exporting.archive import entry
from magiclens.processes.layers import Slicing

if TYPE_CHECKING:
    from magiclens.exporting.voxels import Bitmap, VoxelGrid

_MOST_PIXELS = 10**8
"""Most pixels of a layer; more need more memory than a desktop has."""
_MOST_LAYERS = 10**5
"""Most layers; their names have five digits."""


class Slices(Exporter):
    """Voxel layers for jetting printers: a zip with one black-and-white PNG per layer and a manifest.

    White is material. ``layer-00000.png`` lies on the build plate; row 0 is at +y, as the viewer sees the lens.
    """

    type: ClassVar[str] = "slices"
    suffix: ClassVar[str] = ".slices.zip"

    dpi_x: float = Field(600.0, ge=10, le=10000, description="pixels per inch along x")
    dpi_y: float = Field(300.0, ge=10, le=10000, description="pixels per inch along y")
    layer: Length = Field("27um", validate_default=True, gt=0, description="height of a layer")
    slicing: Slicing = Field(
        "plain", description="how heights become layers: plain rounding, or error diffusion, which leaves no stairs"
    )

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the archive layer by layer. Raises InputError if the stack would be too large.

        With error diffusion, what overhangs is filled down to the bottom: a column of voxels has one height.
        """
        from magiclens.exporting.voxels import VoxelGrid, layers

        grid = VoxelGrid.around(solid, (25.4 / self.dpi_x, 25.4 / self.dpi_y), self.layer)
        self._check(grid)
        filled = 0  # number of voxels
        with ZipFile(path, "w") as archive:
            for k, (bitmap, changed) in enumerate(layers(solid, grid, self.slicing)):
                if changed or k == 0:  # layers that are alike are compressed once
                    png = self._png(bitmap, grid)
                    inside = int(np.bitwise_count(bitmap).sum(dtype=np.int64))
                filled += inside
                archive.writestr(entry(_name(k), packed=False), png)
            facts = {**_manifest(grid, filled * grid.voxel_mm3), "slicing": self.slicing}
            text = json.dumps(facts, indent=2) + "\n"
            archive.writestr(entry("manifest.json"), text)

    def _check(self, grid: VoxelGrid) -> None:
        layers, rows, columns = grid.shape
        if rows * columns > _MOST_PIXELS:
            wish = f"a layer would have {columns} x {rows} pixels, more than {_MOST_PIXELS:,}"
            raise InputError(f"{wish}; lower dpi_x and dpi_y, now {self.dpi_x:g} and {self.dpi_y:g}", "exporter slices")
        if layers > _MOST_LAYERS:
            wish = f"there would be {layers} layers, more than {_MOST_LAYERS:,}"
            raise InputError(f"{wish}; raise layer, now {LENGTH.text(self.layer)}", "exporter slices")

    def _png(self, bitmap: Bitmap, grid: VoxelGrid) -> bytes:
        """A layer as a file that knows its physical size."""
        from PIL import Image

        file = BytesIO()
        image = Image.frombytes("1", (grid.shape[2], grid.shape[1]), bitmap.tobytes())
        image.save(file, format="PNG", compress_level=1, dpi=(self.dpi_x, self.dpi_y))
        return file.getvalue()


def _name(layer: int) -> str:
    return f"layer-{layer:05d}.png"


def _manifest(grid: VoxelGrid, filled_mm3: float) -> dict[str, Any]:
    layers, rows, columns = grid.shape
    return {
        "format": "magiclens slices",
        "unit": "mm",
        "layers": layers,
        "layer_mm": grid.layer_mm,
        "pixels": [columns, rows],
        "pixel_mm": list(grid.pixel_mm),
        "first_voxel_mm": list(grid.first_mm),
        "first_layer": _name(0),
        "last_layer": _name(layers - 1),
        "material": "white",
        "order": "layers from the build plate up, rows from +y down, columns from -x on",
        "filled_mm3": filled_mm3,
    }
