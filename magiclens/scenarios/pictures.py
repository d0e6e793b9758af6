"""Sources and targets as a spec words them, and their rasters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from magiclens.config.fields import ArtName, ImageFile
from magiclens.config.model import SpecModel
from magiclens.contract.artifacts import FloatArray
from magiclens.contract.units import Fraction, Length

Art = Mapping[str, Callable[[int], FloatArray]]
"""Named pictures: from a size in pixels to (size, size, C) linear light."""

SOURCE_PX_PER_MM = 15.0
"""Bilinear lookup in a coarser source would cost the picture more than the lens does."""

LARGEST_PX = 4096
TARGET_ART_PX = 1024


def _quoted(value: object) -> object:
    if isinstance(value, int | float):
        raise ValueError(f"expected text, got {value!r}; write it in quotes")
    return value


def _readable(words: str) -> str:
    from magiclens.images.text import check_words

    check_words(words)
    return words


Words = Annotated[
    str, BeforeValidator(_quoted), AfterValidator(_readable), WithJsonSchema({"type": "string", "minLength": 1})
]
"""A text that can be shown as a picture."""


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
        from magiclens.images.resample import padded_to_square, resize

        picture = padded_to_square(read_image(self.path))
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


class Plain(_Source):
    """Plain paper."""

    type: Literal["plain"]
    level: Fraction = Field("100%", validate_default=True, ge=0, le=1, description="display value; 100% is white")

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, 1) float32, linear light."""
        from magiclens.images.colour import to_linear

        side = _pixels(size_mm)
        return np.array(np.broadcast_to(to_linear(np.array(self.level)), (side, side, 1)), np.float32)

    def __str__(self) -> str:
        return f"plain {self.level:.0%}"


class TextSource(_Source):
    """Readable text, bold black on white, as large as fits."""

    type: Literal["text"]
    text: Words = Field(description="what to write; line breaks are kept, others made where they are needed")
    box: list[Fraction] = Field(
        ["6%", "6%", "94%", "94%"],
        validate_default=True,
        min_length=4,
        max_length=4,
        description="left, top, right and bottom of the text in the square",
    )

    @field_validator("box")
    @classmethod
    def _inside(cls, value: list[float]) -> list[float]:
        from magiclens.images.text import check_box

        check_box(value)
        return value

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, 1) float32, linear light."""
        from magiclens.images.text import text

        left, top, right, bottom = self.box
        return text(self.text, _pixels(size_mm), (left, top, right, bottom))

    def __str__(self) -> str:
        return f"text {self.text!r}"


Source = Annotated[Circles | ImageSource | ArtSource | TextSource | Plain, Field(discriminator="type")]
"""What lies below the lens: generated, a file, built-in art, or text."""


class Look(SpecModel):
    """How a picture is made fit to be a target."""

    fit: Literal["pad", "crop"] | None = Field(
        None, description="a picture that is not square: `pad`, on white paper, as by default, or `crop` to its middle"
    )
    levels: list[Fraction] | None = Field(
        None, min_length=2, max_length=2, description="display values that become black and white, such as [10%, 90%]"
    )
    invert: bool | None = Field(None, description="show the negative")

    @field_validator("levels")
    @classmethod
    def _rising(cls, value: list[float] | None) -> list[float] | None:
        if value is not None and not 0 <= value[0] < value[1] <= 1:
            raise ValueError("write what becomes black first, then what becomes white, such as [10%, 90%]")
        return value

    def applied(self, picture: FloatArray) -> FloatArray:
        """(S, S, C) float32, linear light, of a picture (H, W, C) in linear light. Padding stays white."""
        from magiclens.images.resample import cropped_to_square, padded_to_square
        from magiclens.images.tones import toned

        black, white = self.levels or (0.0, 1.0)
        changed = toned(picture, black, white, bool(self.invert)) if self.levels or self.invert else picture
        return cropped_to_square(changed) if self.fit == "crop" else padded_to_square(changed)


class Target(Look):
    """What the eye shall see: a picture file, built-in art by its name, or text."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": [key]} for key in ("image", "art", "text")]})

    image: ImageFile | None = Field(None, description="picture file, relative to the spec")
    art: ArtName | None = Field(None, description="name of a built-in picture")
    text: Words | None = Field(None, description="what to write, black on white, as large as fits")

    @model_validator(mode="before")
    @classmethod
    def _some(cls, data: Any) -> Any:
        if isinstance(data, dict) and not {key for key, value in data.items() if value is not None}:
            raise ValueError('name a picture: {image: file.png}, {art: panda} or {text: "42"}')
        return data

    @field_validator("art", "text")
    @classmethod
    def _one(cls, value: str | None, info: ValidationInfo) -> str | None:
        others = [key for key in ("image", "art") if info.data.get(key) is not None]
        if value is not None and others:
            raise ValueError(f"give one of {others[0]} and {info.field_name}, not both")
        return value

    def raster(self, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light: files at their own resolution, made square."""
        return self.applied(self._picture(art))

    def _picture(self, art: Art) -> FloatArray:
        if self.art is not None:
            return art[self.art](TARGET_ART_PX)
        if self.text is not None:
            from magiclens.images.text import text

            return text(self.text, TARGET_ART_PX)
        from magiclens.images.files import read_image

        return read_image(self.image or "")

    def __str__(self) -> str:
        if self.image is not None:
            return self.image.name
        return f"art {self.art}" if self.art is not None else f"text {self.text!r}"


def _pixels(size_mm: float) -> int:
    """Side of a source raster at the least resolution that does not cost picture quality."""
    return min(int(np.ceil(size_mm * SOURCE_PX_PER_MM)), LARGEST_PX)
