"""Looks at a user's picture and says how it should be shown, and why."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import luminance, read_image, resize, to_display
from magiclens.images.resample import cropped_to_square, padded_to_square
from magiclens.images.tones import toned

SIDE = 512
"""Pixels at which pictures are judged."""
LEAST_CONTRAST = 0.1
"""Display values between the darkest and the lightest hundredth of a picture that shows something."""
MID_TONES = 0.25
"""A picture with more of them is a photograph, or like one."""
DARK_GROUND = 0.35
COLOURED, COLOURFUL = 0.15, 0.05
"""A pixel is coloured if its channels differ by more, a picture if more of its pixels are."""
FINE = 1 / 30
"""Strokes thinner than this share of the picture are lost between 32 facets."""


@dataclass(frozen=True)
class Judgement:
    """What was found in a picture. levels: display values of its darkest and lightest hundredth; None: full contrast.

    stroke: mean width of what is drawn, as a share of the picture's width.
    """

    path: Path
    size: tuple[int, int]
    photograph: bool
    levels: tuple[float, float] | None
    invert: bool
    coloured: bool
    stroke: float

    @property
    def crop(self) -> bool:
        """Whether to cut it to its middle: what is drawn on plain paper can get more paper, a photograph cannot."""
        return self.photograph and self.size[0] != self.size[1]

    @property
    def fine(self) -> bool:
        """Whether 32 x 32 facets are too coarse for it."""
        return self.photograph or self.stroke < FINE

    @property
    def reasons(self) -> list[str]:
        """What was found and what was done about it, a sentence each."""
        width, height = self.size
        kind = "a photograph, or like one: many tones between black and white" if self.photograph else "a drawing"
        found = [f"{self.path.name}: {width} x {height} pixels, {kind}."]
        if self.crop:
            found.append("It is cut to its middle square, so that no white bands appear beside it.")
        if not self.photograph and width != height:
            found.append("It is centred on white paper.")
        if self.levels:
            low, high = (f"{100 * level:.0f} %" for level in self.levels)
            found.append(f"Its tones, from {low} to {high}, are spread to black and white: discs have nothing between.")
        if self.invert:
            found.append("It is light on dark; its negative has the white ground that the paper around the lens has.")
        return found


def judge(path: Path) -> Judgement:
    """Judge a picture file. Raises InputError if it cannot be read, or shows next to nothing."""
    picture = read_image(path)
    shown = to_display(luminance(picture))
    low, high = (float(level) for level in np.percentile(shown, (1, 99)))
    if high - low < LEAST_CONTRAST:
        raise InputError(f"it shows next to nothing: its tones differ by {100 * (high - low):.0f} %", str(path))
    stretched = low > 0.03 or high < 0.97
    levels = (_percent(low), _percent(high)) if stretched else None
    tones = np.clip((shown - low) / (high - low), 0, 1)
    photograph = float(((tones > 0.15) & (tones < 0.85)).mean()) > MID_TONES
    invert = not photograph and float(np.median(_border(tones))) < DARK_GROUND
    black, white = levels or (0.0, 1.0)
    whole = (cropped_to_square if photograph else padded_to_square)(toned(picture, black, white, invert))
    small = resize(whole, (SIDE, SIDE))
    size = (picture.shape[1], picture.shape[0])
    return Judgement(path, size, photograph, levels, invert, _colourful(picture), _stroke(_dark(small)))


def _percent(level: float) -> float:
    return round(level, 2)


def _border(tones: FloatArray) -> FloatArray:
    """The outermost pixels of a picture (H, W), in a row."""
    wide = max(1, min(tones.shape) // 50)
    edges = (tones[:wide], tones[-wide:], tones[:, :wide], tones[:, -wide:])
    return np.concatenate([edge.ravel() for edge in edges])


def _colourful(picture: FloatArray) -> bool:
    return bool((np.ptp(to_display(picture), axis=-1) > COLOURED).mean() > COLOURFUL)


def _dark(picture: FloatArray) -> BoolArray:
    """(S, S): ink."""
    dark: BoolArray = to_display(luminance(picture)) < 0.5
    return dark


def _stroke(ink: BoolArray) -> float:
    """Mean width of what is drawn, as a share of the picture: a long stroke of width w has area w L and outline 2 L.

    The outline of a digital picture, its edges counted along rows and columns, is longer by 4 / pi on average.
    """
    edges = int((ink[1:] != ink[:-1]).sum() + (ink[:, 1:] != ink[:, :-1]).sum())
    return 2 * float(ink.sum()) / max(edges * np.pi / 4, 1) / len(ink)
