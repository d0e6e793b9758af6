"""Assesses a user's picture: what kind of picture it is, and how a lens should show it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import luminance, read_image, resize, to_display
from magiclens.images.files import check_not_tiny, lies_on_black
from magiclens.images.movies import is_animated, read_frames
from magiclens.images.resample import cropped_to_square, padded_to_square
from magiclens.images.tones import toned

Crop = Literal["auto", "centre", "fit"]
"""How pictures are made square: as suits them, cut to their middle, or padded with white paper."""
Ground = Literal["auto", "light", "dark"]
"""What a picture's border is made: as suits it, light, or dark; by showing the negative where it is not so."""

_SIDE_PX = 512
"""Side of the square to which a picture is resized before its strokes are measured."""

_LEAST_CONTRAST = 0.1
"""Least difference of display values between the darkest and the lightest hundredth of a picture."""

_PHOTOGRAPH_SHARE = 0.25
"""Share of pixels with middle tones from which a picture counts as a photograph."""

_DARK_GROUND = 0.35
"""Display value below which the border of a picture counts as dark."""

_COLOURED_DIFFERENCE = 0.15
"""Difference between channels, in display values, from which a pixel counts as coloured."""

_COLOURED_SHARE = 0.05
"""Share of coloured pixels from which a picture counts as coloured."""

_FINE_STROKE = 1 / 30
"""Width of strokes, as a share of the picture's, below which 32 facets along a side are too few to show them."""


@dataclass(frozen=True)
class Treatment:
    """What a user wants done to pictures, besides what suits them.

    Attributes:
        crop: How they are made square.
        contrast: Share of their range of tones that becomes black or white, half of it at each end; below 1.
        ground: What their border is made.
    """

    crop: Crop = "auto"
    contrast: float = 0.0
    ground: Ground = "auto"


AS_SUITS = Treatment()
"""Nothing besides what suits a picture."""


@dataclass(frozen=True)
class Assessment:
    """What was found in a picture.

    Attributes:
        path: The picture's file.
        size: (width, height) in pixels.
        photograph: Whether it has many tones between black and white.
        levels: Display values that become black and white: of its darkest and its lightest hundredth, or nearer to each
            other if more contrast is wanted; None if they are about black and white.
        invert: Whether its negative is shown, as of a light drawing on a dark ground.
        coloured: Whether it has colours.
        stroke: Mean width of what is drawn, as a share of the picture's width.
        on_black: Whether it is transparent in places and lies on black, as white paper would hide it.
        treatment: What the user wants done to it.
    """

    path: Path
    size: tuple[int, int]
    photograph: bool
    levels: tuple[float, float] | None
    invert: bool
    coloured: bool
    stroke: float
    on_black: bool = False
    treatment: Treatment = AS_SUITS

    @property
    def crop(self) -> bool:
        """Whether to cut it to its middle square: a drawing can be centred on more white paper, a photograph cannot."""
        wanted = self.photograph if self.treatment.crop == "auto" else self.treatment.crop == "centre"
        return wanted and self.size[0] != self.size[1]

    def shown(self, picture: FloatArray, side_px: int) -> FloatArray:
        """The picture (H, W, C) as the target shows it, in linear light: (S, S, C) of this side."""
        square = cropped_to_square if self.crop else padded_to_square
        return resize(square(toned(picture, *(self.levels or (0.0, 1.0)), self.invert)), (side_px, side_px))

    @property
    def fine(self) -> bool:
        """Whether it has more detail than 32 x 32 facets show."""
        return self.photograph or self.stroke < _FINE_STROKE

    @property
    def reasons(self) -> list[str]:
        """What was found and what is done about it, in sentences."""
        width, height = self.size
        kind = "a photograph, or like one: many tones between black and white" if self.photograph else "a drawing"
        found = [f"{self.path.name}: {width} x {height} pixels, {kind}."]
        if self.on_black:
            found.append("What is transparent is black: on white paper nothing of it would show.")
        if self.crop:
            found.append("It is cut to its middle square, so that no white bands appear beside it.")
        elif width != height:
            found.append("It is centred on white paper.")
        if self.levels:
            low, high = (f"{100 * level:.0f} %" for level in self.levels)
            found.append(f"Its tones, from {low} to {high}, are spread to black and white.")
        if self.invert and self.treatment.ground != "auto":
            found.append(f"Its negative has the {self.treatment.ground} ground that was chosen.")
        elif self.invert:
            found.append("It is light on dark; its negative has the white ground that the paper around the lens has.")
        return found


def assess(path: Path, treatment: Treatment = AS_SUITS, moving: bool = False) -> Assessment:
    """Assess a picture file.

    Args:
        path: The file.
        treatment: What is done to it, besides what suits it.
        moving: Whether it may have several frames, of which the first is assessed.

    Raises:
        InputError: It cannot be read, is tiny, or has nearly no contrast.
    """
    animated = moving and is_animated(path)
    picture = next(iter(read_frames(path))) if animated else read_image(path)
    check_not_tiny(picture, path)
    shown = to_display(luminance(picture))
    low, high = (float(level) for level in np.percentile(shown, (1, 99)))
    if high - low < _LEAST_CONTRAST:
        raise InputError(f"it shows next to nothing: its tones differ by {100 * (high - low):.0f} %", str(path))
    # scans and JPEGs are never quite black or white; 3 % does not show
    cut = treatment.contrast * (high - low) / 2
    stretched = low > 0.03 or high < 0.97 or cut > 0
    levels = (_percent(low + cut), _percent(high - cut)) if stretched else None
    tones = np.clip((shown - low) / (high - low), 0, 1)
    photograph = float(((tones > 0.15) & (tones < 0.85)).mean()) > _PHOTOGRAPH_SHARE
    border = float(np.median(_border(tones)))
    dark = border < (_DARK_GROUND if treatment.ground == "auto" else 0.5)
    invert = dark and not photograph if treatment.ground == "auto" else dark == (treatment.ground == "light")
    size, on_black = (picture.shape[1], picture.shape[0]), not animated and lies_on_black(path)
    found = Assessment(path, size, photograph, levels, invert, _colourful(picture), 0.0, on_black, treatment)
    return replace(found, stroke=_stroke(_dark(found.shown(picture, _SIDE_PX))))


def _percent(level: float) -> float:
    return round(level, 2)


def _border(tones: FloatArray) -> FloatArray:
    """Display values of the outermost pixels: (pixels,) of a picture (H, W)."""
    wide = max(1, min(tones.shape) // 50)
    edges = (tones[:wide], tones[-wide:], tones[:, :wide], tones[:, -wide:])
    return np.concatenate([edge.ravel() for edge in edges])


def _colourful(picture: FloatArray) -> bool:
    return bool((np.ptp(to_display(picture), axis=-1) > _COLOURED_DIFFERENCE).mean() > _COLOURED_SHARE)


def _dark(picture: FloatArray) -> BoolArray:
    """Where a picture (S, S, C) in linear light is dark: (S, S)."""
    dark: BoolArray = to_display(luminance(picture)) < 0.5
    return dark


def _stroke(ink: BoolArray) -> float:
    """Mean width of what is drawn, as a share of the picture's side: 2 area / outline.

    A long stroke of width w and length L has the area w L and an outline of 2 L. Edges of pixels along rows and columns
    make an outline that is longer by 4 / pi, on average over all directions, so their number is corrected by that.
    """
    edges = int((ink[1:] != ink[:-1]).sum() + (ink[:, 1:] != ink[:, :-1]).sum())
    return 2 * float(ink.sum()) / max(edges * np.pi / 4, 1) / len(ink)
