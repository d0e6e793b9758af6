"""Stacks of pictures, one per layer, as printers that jet droplets or cure resin layer by layer take them."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from magiclens.contract.artifacts import Lens, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Exporter
from magiclens.contract.units import LENGTH, Length
from magiclens.exporting.archive import entry
from magiclens.exporting.png import png
from magiclens.kernels.spreading import is_spread, shares, spread
from magiclens.kernels.threads import side_by_side_ahead
from magiclens.processes.diffusion import diffusion_weights
from magiclens.processes.layers import Grey, Slicing
from magiclens.processes.linear import LinearProcess
from magiclens.processes.tilting import Tilt

if TYPE_CHECKING:
    from magiclens.exporting.voxels import BitLayers, GreyLayers, VoxelGrid

    Layers = BitLayers | GreyLayers

_MOST_PIXELS = 10**8
"""Most pixels of a layer; more need more memory than a desktop has."""
_MOST_LAYERS = 10**5
"""Most layers; their names have five digits."""
_SWING = 2
"""Layers above the highest point of a solid that error diffusion may use."""
_FINER = 8
"""A worker of a cluster gets no fewer layers at once than its share divided by this; see ``shares``."""
_NAME = "layer-{:05d}.png"
"""Names of the files in ``slices``, by number of the layer."""
_Side = Annotated[Length, Field(ge=1, le=2000)]
"""Of the room that a printer has."""


class LayerStack(Exporter):
    """What all archives of layers share: the voxels, and how heights become layers of them."""

    dpi_x: float = Field(600.0, ge=10, le=10000, description="pixels per inch along x")
    dpi_y: float = Field(300.0, ge=10, le=10000, description="pixels per inch along y")
    layer: Length = Field("27um", validate_default=True, ge=1e-6, le=1000, description="height of a layer")
    slicing: Slicing = Field(
        "plain", description="how heights become layers: plain rounding, or error diffusion, which leaves no stairs"
    )
    grey: Grey | None = Field(None, description="exposure in steps on top of columns; black and white if left out")
    process: LinearProcess = Field(
        {}, validate_default=True, description="what the machine evens out; error diffusion puts its noise there"
    )
    tilt: Tilt | None = Field(
        None, description="how the lens stands on the plate, flat if left out; supports below it are not in the layers"
    )

    def require_possible(self, lens: Lens) -> None:
        """The stack of a flat lens must not be too large; a top that swings beyond its mean height makes it larger."""
        sides = np.array([lens.size_mm, lens.size_mm, lens.thickness_mm])
        box = self.tilt.box_mm(sides) if self.tilt else sides
        columns, rows, layers = (int(n) for n in box / [25.4 / self.dpi_x, 25.4 / self.dpi_y, self.layer])
        self._require_room((layers, rows, columns))

    def _standing(self, solid: Solid) -> Solid:
        """The solid as it stands on the plate."""
        return self.tilt.stood(solid) if self.tilt else solid

    def _grid(self, solid: Solid) -> VoxelGrid:
        """Where the voxels are. Raises InputError if the stack would be too large."""
        from magiclens.exporting.voxels import VoxelGrid

        grid = VoxelGrid.around(solid, (25.4 / self.dpi_x, 25.4 / self.dpi_y), self.layer)
        layers, rows, columns = grid.shape
        if self.slicing == "diffused":
            layers += _SWING
            grid = replace(grid, shape=(layers, rows, columns))
        self._require_room((layers, rows, columns))
        return grid

    def _require_room(self, shape: tuple[int, int, int]) -> None:
        """Raise InputError if a stack of so many layers, rows and columns is too large."""
        layers, rows, columns = shape
        if rows * columns > _MOST_PIXELS:
            wish = f"a layer would have {columns} x {rows} pixels, more than {_MOST_PIXELS:,}"
            lower = f"lower dpi_x and dpi_y, now {self.dpi_x:g} and {self.dpi_y:g}"
            raise InputError(f"{wish}; {lower}", keys=("dpi_x", "dpi_y"))
        if layers > _MOST_LAYERS:
            wish = f"there would be {layers} layers, more than {_MOST_LAYERS:,}"
            raise InputError(f"{wish}; raise layer, now {LENGTH.text(self.layer)}", keys=("layer",))

    def _layers(self, solid: Solid, grid: VoxelGrid) -> Layers:
        """The layers of a solid that stands on the plate."""
        from magiclens.exporting.voxels import BitLayers, GreyLayers

        weights, flat = diffusion_weights(self.process, grid.pixel_mm), self.tilt is None
        if self.grey:
            return GreyLayers.of(solid, grid, self.slicing, self.grey, weights, flat)
        return BitLayers.of(solid, grid, self.slicing, weights, flat)

    def _write_layers(self, archive: ZipFile, solid: Solid, grid: VoxelGrid, name: str) -> float:
        """Write a PNG per layer; their filled volume, mm^3. The number of the layer is formatted into ``name``."""
        stack, count = _Stack(self, grid, self._layers(solid, grid)), grid.shape[0]
        # here they are written as they come; others send back blocks of them
        files = stack.files(range(count))
        if is_spread():
            blocks = shares(count, _FINER)
            files = itertools.chain.from_iterable(block for _, block in spread(_files, stack, blocks))
        total, file = 0.0, b""
        for k, layer in enumerate(files):
            total += layer.filled
            file = layer.file or file  # layers that are alike are compressed once
            # a repeated layer is most often a whole square, whose file shrinks to a hundredth once more
            archive.writestr(entry(name.format(k), packed=not layer.changed), file)
        return total * grid.voxel_mm3

    def _png(self, pixels: NDArray[np.uint8], grid: VoxelGrid) -> bytes:
        """A layer as a file."""
        return png(pixels, (self.dpi_x, self.dpi_y), 0 if self.grey else grid.shape[2])


class _File(NamedTuple):
    """A layer as it is written.

    Args:
        file: Its PNG; None if it is that of the layer below.
        changed: Whether it differs from the layer below.
        filled: How many voxels are filled; those on top of columns count in part.
    """

    file: bytes | None
    changed: bool
    filled: float


@dataclass(frozen=True)
class _Stack:
    """The layers of a solid, and what makes files of them."""

    options: LayerStack
    grid: VoxelGrid
    layers: Layers

    def files(self, wanted: range) -> Iterator[_File]:
        """Some layers from the lowest of them up; the first of them has a file in any case."""
        return side_by_side_ahead(self._packed, self._counted(wanted))

    def _counted(self, wanted: range) -> Iterator[tuple[NDArray[np.uint8] | None, bool, float]]:
        """Pixels, None if they are those of the layer below; whether they are not; and filled voxels."""
        from PIL import Image

        grey, filled = self.options.grey, 0.0
        share = grey.share_of_pixels() if grey else None
        for k, (pixels, changed) in zip(wanted, self.layers.pixels(wanted), strict=True):
            needed = changed or k == wanted.start
            if needed and share is not None:  # Pillow counts some times as fast as numpy, and in no more memory
                filled = float(np.array(Image.fromarray(pixels).histogram()) @ share)
            elif needed:
                filled = float(np.bitwise_count(pixels).sum(dtype=np.int64))
            yield pixels.copy() if needed else None, changed, filled

    def _packed(self, layer: tuple[NDArray[np.uint8] | None, bool, float]) -> _File:
        pixels, changed, filled = layer
        return _File(None if pixels is None else self.options._png(pixels, self.grid), changed, filled)


def _files(stack: _Stack, wanted: range) -> list[_File]:
    """Some layers as files. It may be called again with the same layers, on other machines."""
    return list(stack.files(wanted))


class Slices(LayerStack):
    """Voxel layers for jetting printers: a zip with one black-and-white PNG per layer and a manifest.

    White is material. ``layer-00000.png`` lies on the build plate; row 0 is at +y, as the viewer sees the lens. With
    ``grey``, pixels on top of columns are darker than white: the manifest's ``table`` says how high they become.
    """

    type: ClassVar[str] = "slices"
    suffix: ClassVar[str] = ".slices.zip"

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the archive layer by layer. Raises InputError if the stack would be too large.

        With error diffusion or grey, what overhangs is filled down to the bottom: a column of voxels has one height.
        """
        solid = self._standing(solid)
        grid = self._grid(solid)
        with ZipFile(path, "w") as archive:
            filled_mm3 = self._write_layers(archive, solid, grid, _NAME)
            facts = {**_manifest(grid, filled_mm3), "slicing": self.slicing, **self._grey_facts(), **self._tilt_facts()}
            archive.writestr(entry("manifest.json"), json.dumps(facts, indent=2) + "\n")

    def _tilt_facts(self) -> dict[str, Any]:
        return {"tilt": {"about": self.tilt.about, "angle_deg": self.tilt.angle}} if self.tilt else {}

    def _grey_facts(self) -> dict[str, Any]:
        if self.grey is None:
            return {}
        values, shares = (each.tolist() for each in self.grey.steps())
        table = [[value, round(share, 6)] for value, share in zip(values, shares, strict=True)]
        return {"bits": self.grey.bits, "table": [*table, [255, 1.0]]}


class Sl1(LayerStack):
    """Layers for resin printers with a screen: the archive that PrusaSlicer writes for the SL1, and UVtools converts.

    Every PNG is the whole screen, with the lens in its middle. Pictures are mirrored left to right, as the screen is
    looked at from the other side than the part; the archive says so.
    """

    type: ClassVar[str] = "sl1"
    suffix: ClassVar[str] = ".sl1"

    bed: tuple[_Side, _Side, _Side] = Field(
        ("120mm", "68mm", "150mm"), validate_default=True, description="the screen's width and depth, and the height"
    )
    exposure: float = Field(2.5, gt=0, le=1000, description="seconds a layer is exposed; the resin's maker says them")
    first_exposure: float = Field(30.0, gt=0, le=1000, description="seconds the first layer is exposed")

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the archive. Raises InputError if the stack would be too large, or the lens larger than the screen."""
        solid = self._standing(solid)
        grid = self._grid(solid)
        with ZipFile(path, "w") as archive:
            filled_mm3 = self._write_layers(archive, solid, grid, "lens{:05d}.png")
            archive.writestr(entry("config.ini"), _ini(self._job(grid.shape[0], filled_mm3)))
            archive.writestr(entry("prusaslicer.ini"), _ini(self._settings()))

    def _require_room(self, shape: tuple[int, int, int]) -> None:
        super()._require_room(shape)
        _, rows, columns = shape
        screen = self._screen()
        if columns > screen[0] or rows > screen[1]:
            wish = f"the lens has {columns} x {rows} pixels, the screen {screen[0]} x {screen[1]}"
            raise InputError(f"{wish}; make lens.size smaller", keys=("bed",))

    def _screen(self) -> tuple[int, int]:
        """Columns and rows of the screen."""
        return round(self.bed[0] * self.dpi_x / 25.4), round(self.bed[1] * self.dpi_y / 25.4)

    def _png(self, pixels: NDArray[np.uint8], grid: VoxelGrid) -> bytes:
        """A layer, mirrored left to right, in the middle of a dark screen."""
        _, rows, columns = grid.shape
        grey = pixels if self.grey else np.unpackbits(pixels, axis=1, count=columns) * np.uint8(255)
        width, depth = self._screen()
        screen = np.zeros((depth, width), np.uint8)
        left, top = (width - columns) // 2, (depth - rows) // 2
        screen[top : top + rows, left : left + columns] = grey[:, ::-1]
        return png(screen, (self.dpi_x, self.dpi_y))

    def _job(self, layers: int, filled_mm3: float) -> dict[str, object]:
        return {
            "action": "print",
            "expTime": self.exposure,
            "expTimeFirst": self.first_exposure,
            "jobDir": "lens",
            "layerHeight": f"{self.layer:.6g}",
            "materialName": "clear resin",
            "numFade": 0,
            "numFast": layers,
            "numSlow": 0,
            "usedMaterial": f"{filled_mm3 / 1000:.6g}",
        }

    def _settings(self) -> dict[str, object]:
        screen = self._screen()
        return {
            "bed_shape": f"0x0,{self.bed[0]:g}x0,{self.bed[0]:g}x{self.bed[1]:g},0x{self.bed[1]:g}",
            "display_height": f"{self.bed[1]:g}",
            "display_mirror_x": 1,
            "display_mirror_y": 0,
            "display_orientation": "landscape",
            "display_pixels_x": screen[0],
            "display_pixels_y": screen[1],
            "display_width": f"{self.bed[0]:g}",
            "exposure_time": self.exposure,
            "faded_layers": 0,
            "gamma_correction": 1,
            "initial_exposure_time": self.first_exposure,
            "initial_layer_height": f"{self.layer:.6g}",
            "layer_height": f"{self.layer:.6g}",
            "max_print_height": f"{self.bed[2]:g}",
            "printer_technology": "SLA",
        }


def _ini(settings: dict[str, object]) -> str:
    return "".join(f"{key} = {value}\n" for key, value in settings.items())


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
        "first_layer": _NAME.format(0),
        "last_layer": _NAME.format(layers - 1),
        "material": "white",
        "order": "layers from the build plate up, rows from +y down, columns from -x on",
        "filled_mm3": filled_mm3,
    }
