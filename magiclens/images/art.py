"""Built-in pictures by name. They are drawn from outlines, so they have any size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from functools import partial

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images.drawings import answers, clipart
from magiclens.images.drawings.flower import flower
from magiclens.images.drawings.foliage import foliage
from magiclens.images.drawings.truck import truck
from magiclens.images.drawings.worm import worm
from magiclens.images.raster import rasterize
from magiclens.images.vector import Layer, centred

_WORM_FRAMES = 8
"""Frames of the built-in loop ``worm``."""


def art(name: str, size_px: int) -> FloatArray:
    """Draw a built-in picture.

    Args:
        name: Its name, see ``ART``.
        size_px: Its side.

    Returns:
        (size_px, size_px, C) float32, linear light; C is 1 for black and white, 3 for colour.

    Raises:
        InputError: There is no such picture; the message names the nearest one.
    """
    if name not in ART:
        near = get_close_matches(name, ART, n=1, cutoff=0.4)
        hint = f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(sorted(ART))}"
        raise InputError(f"there is no built-in art {name!r}; {hint}")
    return ART[name](size_px)


def _silhouette(drawing: Callable[[], Sequence[Layer]], size_px: int) -> FloatArray:
    """A picture in black on white, centred."""
    return rasterize(centred(drawing()), size_px)


def _worm(frame: int, size_px: int) -> FloatArray:
    """One frame of the worm's loop. It is not centred, since all frames are seen by one camera."""
    return rasterize(worm(frame, _WORM_FRAMES), size_px)


def _painting(drawing: Callable[[], Sequence[Layer]], size_px: int) -> FloatArray:
    """A picture in colour that fills the square."""
    return rasterize(drawing(), size_px, paper=(1.0, 1.0, 1.0))


SILHOUETTES = (
    clipart.panda,
    clipart.bat,
    clipart.penguin,
    clipart.whale,
    clipart.cat,
    clipart.rabbit,
    clipart.owl,
    clipart.elephant,
    clipart.heart,
    clipart.star,
    clipart.question_mark,
    clipart.exclamation,
    clipart.tree,
    clipart.house,
    clipart.sun,
    clipart.moon,
    clipart.fish,
    clipart.key,
    clipart.anchor,
    answers.lincoln,
    answers.washington,
    answers.eiffel_tower,
    answers.dinosaur,
    answers.apple,
    answers.lightbulb,
)
_PAINTINGS = (flower, truck, foliage)

ART: dict[str, Callable[[int], FloatArray]] = {
    **{drawing.__name__: partial(_silhouette, drawing) for drawing in SILHOUETTES},
    **{f"worm-{k}": partial(_worm, k) for k in range(_WORM_FRAMES)},
    **{drawing.__name__: partial(_painting, drawing) for drawing in _PAINTINGS},
}
"""Built-in pictures: functions from a size in pixels to (size, size, C) linear light, by name."""
