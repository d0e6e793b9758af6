"""Sources and targets as a spec words them, and their rasters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from magiclens.artifacts import FloatArray
from magiclens.spec.fields import ArtName, ImageFile
from magiclens.spec.model import SpecModel
from magiclens.units import Length

Art = Mapping[str, Callable[[int], FloatArray]]
"""Named pictures: from a size in pixels to (size, size, C) linear light."""

SOURCE_PX_PER_MM = 15.0
"""Bilinear lookup in a coarser source would cost the picture more than the lens does."""

LARGEST_PX = 4096
TARGET_ART_PX = 1024


class _Source(SpecModel, ABC):
    """What lies below the lens."""

    size: Length | None = Field(None, gt=0, description="side of the square source; as large as the lens by default")

    @abstractmethod
    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light, covering ``size_mm``: at least 15 px/mm unless that is past 4096 pixels."""


class Circles(_Source):
    """Random discs, the paper's source."""

    type: Literal["circles"]
    seed: int = Field(0, strict=True, ge=0, description="another seed, other discs")
    radius: list[Length] = Field(
        ["0.5mm", "2.5mm"], validate_default=True, min_length=2, max_length=2, description="smallest and largest disc"
    )
    colours: Literal["black-and-white", "coloured"] = Field("black-and-white", description="the discs' inks")
    layers: float = Field(4.0, gt=0, le=100, description="how many discs lie on a point on average")

    @field_validator("radius")
    @classmethod
    def _ordered(cls, value: list[float]) -> list[float]:
        if not 0 < value[0] <= value[1]:
            raise ValueError("write the smallest radius first, more than 0mm, such as [0.5mm, 2.5mm]")
        return value

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light."""
        from magiclens.images.sources import BLACK_AND_WHITE, COLOURED, circles

        inks = COLOURED if self.colours == "coloured" else BLACK_AND_WHITE
        rng = np.random.default_rng(self.seed)
        return circles(size_mm, _pixels(size_mm) / size_mm, rng, (self.radius[0], self.radius[1]), inks, self.layers)

    def __str__(self) -> str:
        return f"circles (seed {self.seed})"


class ImageSource(_Source):
    """A picture file."""

    type: Literal["image"]
    path: ImageFile = Field(description="picture file, relative to the spec")

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light; as fine as the file if that is finer than 15 px/mm."""
        from magiclens.images.files import read_image
        from magiclens.images.resample import resize, square

        picture = square(read_image(self.path))
        side = min(max(_pixels(size_mm), len(picture)), LARGEST_PX)
        return resize(picture, (side, side))

    def __str__(self) -> str:
        return self.path.name


class ArtSource(_Source):
    """A built-in picture."""

    type: Literal["art"]
    name: ArtName = Field(description="name of the picture")

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light."""
        return art[self.name](_pixels(size_mm))

    def __str__(self) -> str:
        return f"art {self.name}"


Source = Annotated[Circles | ImageSource | ArtSource, Field(discriminator="type")]
"""What lies below the lens: generated, a file, or built-in art."""


class Target(SpecModel):
    """What the eye shall see: a picture file, or built-in art by its name."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["image"]}, {"required": ["art"]}]})

    image: ImageFile | None = Field(None, description="picture file, relative to the spec")
    art: ArtName | None = Field(None, description="name of a built-in picture")

    @model_validator(mode="before")
    @classmethod
    def _some(cls, data: Any) -> Any:
        if isinstance(data, dict) and not {key for key, value in data.items() if value is not None}:
            raise ValueError("name a picture: {image: file.png} or {art: panda}")
        return data

    @field_validator("art")
    @classmethod
    def _one(cls, value: str | None, info: ValidationInfo) -> str | None:
        if value is not None and info.data.get("image"):
            raise ValueError("give an image or art, not both")
        return value

    def raster(self, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light: files at their own resolution, padded to a square."""
        if self.art is not None:
            return art[self.art](TARGET_ART_PX)
        from magiclens.images.files import read_image
        from magiclens.images.resample import square

        return square(read_image(self.image or ""))

    def __str__(self) -> str:
        return self.image.name if self.image else f"art {self.art}"


def _pixels(size_mm: float) -> int:
    """Side of a source raster at the least resolution that does not cost picture quality."""
    return min(int(np.ceil(size_mm * SOURCE_PX_PER_MM)), LARGEST_PX)
