"""The ``universal-animation`` scenario: a lens for any pictures, here an animation (section 5, figures 9 and 15)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import count, islice
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from magiclens.config.fields import ImageFile, InputFile, readable_picture
from magiclens.config.model import Choice, Viewer
from magiclens.contract.artifacts import BoolArray, FloatArray, Lens
from magiclens.scenarios.base import Scenario, Shot
from magiclens.scenarios.camouflage import Camouflage
from magiclens.scenarios.pictures import AdjustedPicture, Art, Source, Target

UNIVERSAL_LENS = {"facets": 16, "microfacets": 64}
"""Each facet shows a patch as fine as it is painted, so that a few large facets are best."""
_STEP_WEIGHT = 1e-5
"""Weight of steps between facets for universal lenses, which nearly ignore them (see ``universal_stages``)."""
_MOST_FRAMES = 64
"""Largest number of frames in a spec, since a run encodes and renders all; ``mlens encode`` takes longer movies."""


class Frame(Target):
    """A target that is one frame of a movie file."""

    movie: Path
    number: int

    @model_validator(mode="before")
    @classmethod
    def _some(cls, data: Any) -> Any:
        return data  # a frame needs none of the pictures that any other target must name

    def raster(self, art: Art) -> FloatArray:
        """(S, S, C) float32, linear light."""
        return self.adjusted(np.asarray(_movie(self.movie)[self.number]))

    def __str__(self) -> str:
        return f"{self.movie.name} frame {self.number}"


def _readable(path: Path) -> Path:
    from magiclens.contract.errors import InputError
    from magiclens.images.movies import is_animated

    try:
        if is_animated(path):
            _movie(path)
            return path
    except InputError as error:
        raise ValueError(error.message) from None
    return readable_picture(path)


FramesFile = Annotated[InputFile, AfterValidator(_readable)]
"""A picture file, still or animated."""


class Frames(AdjustedPicture):
    """The pictures that the eye shall see in turn: a built-in loop, picture files, or a movie."""

    art: str | None = Field(None, description="name of a built-in loop, such as worm for worm-0, worm-1, ...")
    length: int | None = Field(None, ge=1, description="frames of the built-in loop; all of them by default")
    images: list[FramesFile] | None = Field(
        None, min_length=1, description="picture files; an animated one stands for all of its frames"
    )
    movie: InputFile | None = Field(None, description="a GIF or MP4 file")

    @model_validator(mode="after")
    def _one_kind(self, info: ValidationInfo) -> Frames:
        if sum(value is not None for value in (self.art, self.images, self.movie)) != 1:
            raise ValueError("name the frames: {art: worm}, {images: [a.png, b.png]} or {movie: film.gif}")
        names = (info.context or {}).get("art")
        if self.art is not None and names is not None:
            there = next(k for k in count() if f"{self.art}-{k}" not in names)
            if not there:
                raise ValueError(f"there is no built-in loop '{self.art}'; choose one of: {_loops(names)}")
            if self.length is None:
                object.__setattr__(self, "length", there)
            if self.length is not None and self.length > there:
                raise ValueError(f"'{self.art}' has {there} frames, not {self.length}")
        return self

    def targets(self) -> list[Target]:
        """One target per frame, in order; all are adjusted in the same way."""
        adjustments = self.model_dump(mode="json", include=set(AdjustedPicture.model_fields))
        if self.images:
            return [target for path in self.images for target in _targets(path, adjustments)]
        if self.movie:
            return _frames_of(self.movie, adjustments)
        return [Target(art=f"{self.art}-{k}", **adjustments) for k in range(self.length or 0)]


def _targets(path: Path, adjustments: Mapping[str, Any]) -> list[Target]:
    """What a picture file shows: itself, or its frames."""
    from magiclens.images.movies import is_animated

    return _frames_of(path, adjustments) if is_animated(path) else [Target(image=path, **adjustments)]


def _frames_of(movie: Path, adjustments: Mapping[str, Any]) -> list[Target]:
    return [Frame(movie=movie, number=k, **adjustments) for k in range(len(_movie(movie)))]


class UniversalAnimation(Scenario):
    """A lens in which no two facets see the same part of the source, and a painted source for every frame."""

    type: ClassVar[str] = "universal-animation"

    frames: Frames = Field(description="what the eye shall see, one source for each")
    source: Source = Field({"type": "plain"}, validate_default=True, description="what is painted on")
    mask: ImageFile | None = Field(None, description="black where the source must not be used or painted (5.1)")
    subdivisions: int = Field(2, ge=1, le=8, description="sub-regions along one side of a facet's patch (5.1)")
    camouflage: Camouflage = Field(
        {"type": "texture"}, validate_default=True, description="what covers pixels that no facet sees (5.2)"
    )

    fps: float = Field(8.0, ge=0.1, le=50, description="frames per second of the animations")

    @property
    def frames_per_second(self) -> float | None:
        """See ``Scenario``."""
        return self.fps

    def suitable_stages(self) -> dict[str, Choice]:
        """Facets get their parts of the source at random, and sources are painted for the finished lens."""
        return universal_stages(self.subdivisions, self.camouflage)

    def suitable_lens(self) -> dict[str, Any]:
        """See ``UNIVERSAL_LENS``."""
        return UNIVERSAL_LENS

    def reserved(self, lens: Lens, art: Art) -> BoolArray | None:
        """The mask, at the resolution of the source."""
        return None if self.mask is None else read_mask(self.mask, len(self.source.raster(lens.source_size_mm, art)))

    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """One shot per frame, each with a source of its own."""
        eye_mm = viewer.eye_mm(lens)
        names = [f"frame-{k:02}" for k in range(len(self.frames.targets()))]
        return tuple(
            Shot(name, self.source, target, eye_mm, source_name=name, target_name=name)
            for name, target in zip(names, self.frames.targets(), strict=True)
        )


def universal_stages(subdivisions: int, camouflage: Camouflage) -> dict[str, Choice]:
    """The stages of a universal lens.

    Light that is lost at walls counts most, since no painting can restore it; steps themselves hardly matter.

    Args:
        subdivisions: Sub-regions along one side of a facet's patch (5.1).
        camouflage: What covers the pixels that no facet sees (5.2).
    """
    return {
        "matcher": {"type": "dart-throwing", "subdivisions": subdivisions},
        "annealer": {"type": "heat-bath", "step_weight": _STEP_WEIGHT},
        "integrator": {"type": "poisson", "step_weight": _STEP_WEIGHT},
        "encoder": {
            "type": "least-squares",
            "bleed": "0.2mm",
            "camouflage": camouflage.model_dump(mode="json", exclude_none=True),
        },
    }


def read_mask(path: Path, side: int) -> BoolArray:
    """(side, side) pixels at which the picture of a mask is dark; its nearest pixels count."""
    from magiclens.images import luminance, padded_to_square, read_image, to_display

    dark: BoolArray = to_display(luminance(padded_to_square(read_image(path)))) < 0.5
    nearest = ((np.arange(side) + 0.5) * len(dark) / side).astype(int)
    return np.asarray(dark[nearest[:, None], nearest])


@lru_cache(maxsize=2)
def _movie(path: Path) -> Sequence[FloatArray]:
    """The frames (H, W, C) of a movie file, linear light. Raises InputError if there are too many."""
    from magiclens.contract.errors import InputError
    from magiclens.images.movies import read_frames

    frames = [np.asarray(frame) for frame in islice(read_frames(path), _MOST_FRAMES + 1)]
    if len(frames) > _MOST_FRAMES:
        raise InputError(f"it has more than {_MOST_FRAMES} frames; run with a few and use 'mlens encode'", str(path))
    return frames


def _loops(names: Any) -> str:
    """The built-in loops, as text: names of art whose first frame ends in ``-0``."""
    return ", ".join(sorted(name.removesuffix("-0") for name in names if name.endswith("-0")))
