"""How much of its target an eye finds in a picture: multi-scale structural similarity, and a word for it."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.colour import luminance, to_display
from magiclens.images.resample import halved, resize
from magiclens.images.score import score

Word = Literal["clear", "recognisable", "hard to see", "lost"]
"""What an eye makes of a picture."""
_LEAST: dict[Word, float] = {"clear": 0.84, "recognisable": 0.45, "hard to see": 0.25}
"""The least likeness of each word, chosen by the examples of ``docs/draw_verdicts.py`` and by 24 lenses as made."""

_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Of the scales, the finest first (Wang, Simoncelli and Bovik 2003)."""
_WINDOW_PX, _SIGMA_PX = 11, 1.5
"""The Gaussian window within which pixels are compared."""
_LEAST_PX = _WINDOW_PX * 2 ** (len(_WEIGHTS) - 1)
"""Least side of a picture whose coarsest scale still holds a window."""
_C1, _C2 = 0.01**2, 0.03**2
"""What keeps the quotients finite where pictures are black or flat, for values 0 to 1."""
_EYE_DEG = 1 / 60
"""What an eye resolves: one arc minute."""
_COLOURED_FROM = 2
"""The first scale at which colours count: an eye resolves them about four times less finely (Mullen 1985)."""
_COLOUR = 0.5
"""Makes blue and red less brightness, which go from about -0.9 to 0.9, as wide as brightness."""


def likeness(render_linear: FloatArray, target_linear: FloatArray, seen_px: float = math.inf) -> float:
    """How alike a picture and its target are to an eye: 1 if they are equal, about 0 if they have nothing in common.

    It is the multi-scale SSIM of luminance in display values, after the exposure gain that ``score`` fits; at the
    coarser scales, where an eye sees colours, of two differences of colour with it, as one vector. Pixels finer than
    the eye resolves are averaged before; a picture too small for five scales is enlarged. Places count by the target's
    contrast there: lines and noise on what is plain in the target hide nothing of it.

    Args:
        render_linear: (R, R, C) linear light.
        target_linear: (H, W, C) linear light.
        seen_px: How many pixels the eye resolves along the picture's side, see ``resolved_px``.
    """
    side = max(math.ceil(min(len(render_linear), seen_px)), _LEAST_PX)
    render, target = (resize(picture, (side, side)) for picture in (render_linear, target_linear))
    exposed = render * np.float32(score(render, target).gain)
    seen, wanted = _opponents(exposed), _opponents(target)
    product = 1.0
    for scale, weight in enumerate(_WEIGHTS):
        parts = slice(None) if scale >= _COLOURED_FROM else slice(1)
        brightness, structure, contrast = _similarities(seen[..., parts], wanted[..., parts])
        alike = brightness * structure if scale == len(_WEIGHTS) - 1 else structure
        product *= max(float(np.average(alike, weights=contrast)), 0.0) ** weight
        seen, wanted = halved(seen), halved(wanted)
    return product


def word_for(value: float) -> Word:
    """The word for a likeness."""
    return next((word for word, least in _LEAST.items() if value >= least), "lost")


def resolved_px(size_mm: float, distance_mm: float) -> float:
    """How many pixels of one arc minute an eye at a distance sees along a side of so many millimetres."""
    return size_mm / (distance_mm * math.tan(math.radians(_EYE_DEG)))


def _opponents(picture: FloatArray) -> FloatArray:
    """(S, S, 3) brightness, blue less brightness, red less brightness, in display values, of (S, S, C) linear light."""
    brightness = to_display(luminance(picture)).astype(float)[..., None]
    colours = np.broadcast_to(to_display(picture), (*picture.shape[:2], 3))[..., [2, 0]]
    return np.concatenate([brightness, _COLOUR * (colours - brightness)], axis=-1)


def _similarities(seen: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where the window fits in: likeness of brightness, likeness of contrast and structure, and contrast wanted.

    All are (S - 10, S - 10), of two pictures (S, S, C) whose pixels are vectors. With one channel it is the usual SSIM.
    """
    mean_seen, mean_wanted = _blurred(seen), _blurred(wanted)
    product, squares = mean_seen * mean_wanted, mean_seen**2 + mean_wanted**2
    covariance = (_blurred(seen * wanted) - product).sum(-1)
    variances = (_blurred(seen**2 + wanted**2) - squares).sum(-1)
    var_wanted = (_blurred(wanted**2) - mean_wanted**2).sum(-1)
    brightness = (2 * product.sum(-1) + _C1) / (squares.sum(-1) + _C1)
    structure = (2 * covariance + _C2) / (variances + _C2)
    # never all zero, so that a target without any contrast has a mean, too
    return brightness, structure, np.sqrt(np.maximum(var_wanted, 1e-12))


def _blurred(picture: FloatArray) -> FloatArray:
    """(S - 10, S - 10, C) means in the window around each pixel where it fits in."""
    from scipy.ndimage import gaussian_filter

    edge = _WINDOW_PX // 2
    blurred: FloatArray = gaussian_filter(picture, (_SIGMA_PX, _SIGMA_PX, 0), radius=(edge, edge, 0))
    return blurred[edge:-edge, edge:-edge]
