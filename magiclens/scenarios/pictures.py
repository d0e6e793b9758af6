"""Sources and targets as a spec gives them, and their rasters."""

from __future__ import annotations

import re
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
"""Built-in pictures by name: functions from a size in pixels to (size, size, C) linear light."""

_SOURCE_PX_PER_MM = 15.0
"""Least resolution of sources: bilinear look-up in a coarser one would cost the picture more than the lens does."""

_LARGEST_PX = 4096
"""Largest side of a source, so that a large lens does not exhaust the memory."""
_LEAST_RADIUS_MM = 0.05
"""Smallest radius of a disc; millions of smaller ones would be needed, and no source has such fine pixels."""
_MOST_RADIUS_MM = 10_000.0
"""Largest radius of a disc: no source is larger."""
TARGET_ART_PX = 1024
"""Side of targets that are drawn, which is finer than any render."""


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
"""A text that the font can show."""


def _ordered(radii: list[float]) -> list[float]:
    if not _LEAST_RADIUS_MM <= radii[0] <= radii[1] <= _MOST_RADIUS_MM:
        bounds = f"at least {_LEAST_RADIUS_MM:g}mm, at most {_MOST_RADIUS_MM:g}mm"
        raise ValueError(f"write the smallest radius first, {bounds}, such as [0.5mm, 2.5mm]")
    return radii


Radii = Annotated[list[Length], AfterValidator(_ordered)]
"""Smallest and largest radius of random discs."""


def _known_inks(value: object) -> object:
    from magiclens.images.sources import inks

    if isinstance(value, str) and value in _NAMED_INKS:
        return value
    try:
        if isinstance(value, list | tuple) and len(inks(value)) > 1:
            return tuple(value)
    except (ValueError, TypeError):
        pass
    raise ValueError(f"write {' or '.join(_NAMED_INKS)}, or a list such as ['#1a1a1a', '#d62828', '#ffffff']")


_NAMED_INKS = ("black-and-white", "coloured")

Inks = Annotated[
    str | tuple[str, ...],
    BeforeValidator(_known_inks),
    WithJsonSchema(
        {
            "anyOf": [
                {"enum": list(_NAMED_INKS)},
                {"type": "array", "minItems": 2, "items": {"type": "string", "pattern": "^#[0-9a-fA-F]{6}$"}},
            ]
        }
    ),
]
"""The inks of random discs: by name, or as sRGB values."""


class _Source(SpecModel, ABC):
    """A picture below the lens."""

    size: Length | None = Field(
        None, ge=1, le=10_000, description="side of the square source; as large as the lens by default"
    )

    @abstractmethod
    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """The picture in pixels.

        Args:
            size_mm: Side of the source.
            art: Built-in pictures by name.

        Returns:
            (S, S, C) float32, linear light, at least 15 pixels per mm, but at most 4096 pixels.
        """


class Circles(_Source):
    """Random discs, as in the paper's sources."""

    type: Literal["circles"]
    seed: int = Field(0, strict=True, ge=0, description="another seed, other discs")
    radius: Radii = Field(
        ["0.5mm", "2.5mm"], validate_default=True, min_length=2, max_length=2, description="smallest and largest disc"
    )
    colours: Inks = Field("black-and-white", description="the discs' inks, by name or as a list of sRGB values")
    layers: float = Field(4.0, gt=0, le=100, description="how many discs lie on a point on average")

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light."""
        from magiclens.images.sources import circles, inks

        rng, colours = np.random.default_rng(self.seed), inks(self.colours)
        radii = (self.radius[0], self.radius[1])
        return circles(size_mm, pixels_of(size_mm) / size_mm, rng, radii, colours, self.layers)

    @property
    def grey(self) -> bool:
        """Whether no disc is coloured."""
        from magiclens.images.sources import inks

        return len(inks(self.colours)[0]) == 1

    def count(self, size_mm: float) -> int:
        """How many discs there are on a source of this size."""
        from magiclens.images.sources import disc_count

        return disc_count(size_mm, self.radius[0], self.radius[1], self.layers)

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
        side = min(max(pixels_of(size_mm), len(picture)), _LARGEST_PX)
        return resize(picture, (side, side))

    def __str__(self) -> str:
        return self.path.name


class ArtSource(_Source):
    """A built-in picture."""

    type: Literal["art"]
    name: ArtName = Field(description="name of the picture")

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light."""
        return art[self.name](pixels_of(size_mm))

    def __str__(self) -> str:
        return f"art {self.name}"


class Plain(_Source):
    """Plain paper."""

    type: Literal["plain"]
    level: Fraction = Field("100%", validate_default=True, ge=0, le=1, description="display value; 100% is white")

    def raster(self, size_mm: float, art: Art) -> FloatArray:
        """(S, S, 1) float32, linear light."""
        from magiclens.images.colour import to_linear

        side = pixels_of(size_mm)
        return np.array(np.broadcast_to(to_linear(np.array(self.level)), (side, side, 1)), np.float32)

    def __str__(self) -> str:
        return f"plain {self.level:.0%}"


class TextSource(_Source):
    """Readable text, bold black on white, as large as the box allows."""

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
        return text(self.text, pixels_of(size_mm), (left, top, right, bottom))

    def __str__(self) -> str:
        return f"text {self.text!r}"


Source = Annotated[Circles | ImageSource | ArtSource | TextSource | Plain, Field(discriminator="type")]
"""What lies below the lens: random discs, a file, built-in art, text, or plain paper; chosen by ``type``."""


class AdjustedPicture(SpecModel):
    """How a picture is adjusted before it is used as a target: made square, its contrast raised, or inverted."""

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

    def adjusted(self, picture: FloatArray) -> FloatArray:
        """(S, S, C) float32, linear light: the adjusted picture (H, W, C); padding stays white in a negative."""
        from magiclens.images.resample import cropped_to_square, padded_to_square
        from magiclens.images.tones import toned

        black, white = self.levels or (0.0, 1.0)
        changed = toned(picture, black, white, bool(self.invert)) if self.levels or self.invert else picture
        return cropped_to_square(changed) if self.fit == "crop" else padded_to_square(changed)


class Target(AdjustedPicture):
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
        """(S, S, C) float32, linear light; a file keeps its resolution. ``art``: built-in pictures by name."""
        return self.adjusted(self._picture(art))

    def _picture(self, art: Art) -> FloatArray:
        if self.art is not None:
            return art[self.art](TARGET_ART_PX)
        if self.text is not None:
            from magiclens.images.text import text

            return text(self.text, TARGET_ART_PX)
        from magiclens.images.files import read_image

        return read_image(self.image or "")

    @property
    def title(self) -> str:
        """What people call it: the name of the file without its ending, of the art, or the words themselves."""
        return re.sub(r"[-_\s]+", " ", self.image.stem if self.image else self.art or self.text or "").strip()

    def __str__(self) -> str:
        if self.image is not None:
            return self.image.name
        return f"art {self.art}" if self.art is not None else f"text {self.text!r}"


def pixels_of(size_mm: float) -> int:
    """Side in pixels of a source that is generated."""
    return min(int(np.ceil(size_mm * _SOURCE_PX_PER_MM)), _LARGEST_PX)
