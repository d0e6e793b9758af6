"""Camouflage: what covers the pixels of a source that no facet sees (section 5.2)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from magiclens.config.fields import ImageFile
from magiclens.config.model import SpecModel
from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.contract.units import Fraction, Length
from magiclens.scenarios.pictures import Circles, Inks, Radii


class _Cover(SpecModel, ABC):
    @abstractmethod
    def cover(self, source: FloatArray, known: BoolArray, size_mm: float, rng: np.random.Generator) -> FloatArray:
        """Cover the unknown pixels of a source.

        Args:
            source: (H, W, C) linear light.
            known: (H, W) pixels that stay as they are.
            size_mm: Side of the source.
            rng: Randomness.

        Returns:
            (H, W, C) linear light.
        """


class Untouched(_Cover):
    """The given source, unchanged."""

    type: Literal["none"]

    def cover(self, source: FloatArray, known: BoolArray, size_mm: float, rng: np.random.Generator) -> FloatArray:
        """See ``_Cover``."""
        return source


class Flat(_Cover):
    """A plain grey."""

    type: Literal["flat"]
    level: Fraction = Field("100%", validate_default=True, ge=0, le=1, description="display value; 100% is white")

    def cover(self, source: FloatArray, known: BoolArray, size_mm: float, rng: np.random.Generator) -> FloatArray:
        """See ``_Cover``."""
        from magiclens.images import to_linear

        return _filled(source, known, to_linear(np.array(self.level)))


class Noise(_Cover):
    """Random squares of every display value, which look like painted patches and so hide these."""

    type: Literal["noise"]
    grain: Length = Field("0.3mm", validate_default=True, ge=0.01, le=10_000, description="side of the squares")

    def cover(self, source: FloatArray, known: BoolArray, size_mm: float, rng: np.random.Generator) -> FloatArray:
        """See ``_Cover``."""
        from magiclens.images import to_linear

        rows, columns, channels = source.shape
        count = max(round(size_mm / self.grain), 1)
        at = [np.arange(side) * count // side for side in (rows, columns)]
        values = to_linear(rng.random((count, count, channels)).astype(np.float32))
        return _filled(source, known, values[at[0][:, None], at[1]])


class Discs(_Cover):
    """Random discs, as in the ``circles`` source."""

    type: Literal["circles"]
    radius: Radii = Field(
        ["0.5mm", "2.5mm"], validate_default=True, min_length=2, max_length=2, description="smallest and largest disc"
    )
    colours: Inks = Field("black-and-white", description="the discs' inks, see the source's")

    def cover(self, source: FloatArray, known: BoolArray, size_mm: float, rng: np.random.Generator) -> FloatArray:
        """See ``_Cover``."""
        return _filled(source, known, _discs(self, len(source), size_mm, rng))


class Inpaint(_Cover):
    """A smooth continuation of the known pixels around."""

    type: Literal["inpaint"]

    def cover(self, source: FloatArray, known: BoolArray, size_mm: float, rng: np.random.Generator) -> FloatArray:
        """See ``_Cover``."""
        from magiclens.images.inpaint import inpaint

        return inpaint(source, known) if known.any() else source


class Texture(_Cover):
    """A texture synthesised from an example, which joins the known pixels around; random discs by default."""

    type: Literal["texture"]
    model_config = ConfigDict(json_schema_extra={"not": {"required": ["image", "circles"]}})

    image: ImageFile | None = Field(None, description="the example, a picture file")
    circles: Discs | None = Field(None, description="the example, random discs")
    patch: Length = Field(
        "3mm", validate_default=True, ge=0.01, le=10_000, description="as large as the texture's features"
    )

    @model_validator(mode="after")
    def _one_example(self) -> Texture:
        if self.image and self.circles:
            raise ValueError("give an image or circles, not both")
        return self

    def cover(self, source: FloatArray, known: BoolArray, size_mm: float, rng: np.random.Generator) -> FloatArray:
        """See ``_Cover``."""
        from magiclens.images.files import read_image
        from magiclens.images.texture import synthesize

        if self.image:
            example = read_image(self.image)
        else:
            example = _discs(self.circles or Discs(type="circles"), len(source) // 3, size_mm / 3, rng)
        example = _broadcast(example, source.shape[-1])
        return synthesize(example, source, known, rng, max(round(self.patch / size_mm * len(source)), 4))


Camouflage = Annotated[Untouched | Flat | Noise | Discs | Inpaint | Texture, Field(discriminator="type")]
"""What covers the pixels that no facet sees; chosen by ``type``."""


def _discs(options: Discs, side: int, size_mm: float, rng: np.random.Generator) -> FloatArray:
    """(side, side, C) linear light: random discs over a square of this size."""
    from magiclens.images import resize

    source = Circles.model_validate(
        {
            "type": "circles",
            "seed": int(rng.integers(2**31)),
            "radius": [f"{r}mm" for r in options.radius],
            "colours": options.colours,
        }
    )
    return resize(source.raster(size_mm, {}), (side, side))


def _filled(source: FloatArray, known: BoolArray, picture: FloatArray) -> FloatArray:
    """The picture where the source is unknown, else the source; the picture gets as many channels as the source."""
    covering = _broadcast(np.atleast_3d(np.asarray(picture, np.float32)), source.shape[-1])
    return np.where(known[..., None], source, covering).astype(np.float32)


def _broadcast(picture: FloatArray, channels: int) -> FloatArray:
    """(H, W, C) with this number of channels: grey is repeated, and colour becomes its luminance."""
    from magiclens.images import luminance

    if channels == 1 and picture.shape[-1] == 3:
        return np.asarray(luminance(picture)[..., None], np.float32)
    return np.array(np.broadcast_to(picture, (*picture.shape[:2], channels)), np.float32)
