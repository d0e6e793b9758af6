"""Inks for a source whose discs shall have the colours of the pictures that are hidden in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from magiclens.images import read_image, to_display
from magiclens.new.assess import Assessment

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SIDE_PX = 128
"""Side to which pictures are resized: colours of single pixels do not matter."""
_INKS = 8
"""How many inks there are. Of more, each is found in fewer places near a facet."""


def inks_for(pictures: Sequence[Assessment]) -> tuple[str, ...]:
    """The colours that most of the pictures' areas are near to, and their darkest and lightest ones.

    Facets find their colours in such a source, and the strips between facets pass over colours that the picture has.

    Args:
        pictures: What was found in the pictures.

    Returns:
        sRGB values such as ``#d62828``; nothing if black and white are all that the pictures need.
    """
    shown = [_pixels(each) for each in pictures if each.photograph or each.coloured]
    if not shown:
        return ()
    from PIL import Image

    pixels = np.concatenate(shown)
    usual = Image.fromarray(pixels[None]).quantize(_INKS - 2, Image.Quantize.MEDIANCUT, kmeans=_INKS)
    palette = np.array((usual.getpalette("RGB") or [])[: 3 * (_INKS - 2)], float).reshape(-1, 3)
    order = np.argsort(pixels.sum(axis=1), kind="stable")
    few = max(len(order) // 50, 1)
    extremes = [pixels[order[:few]].mean(axis=0), pixels[order[-few:]].mean(axis=0)]
    found = np.rint(np.concatenate([palette, extremes])).astype(int).tolist()
    return tuple(dict.fromkeys("#{:02x}{:02x}{:02x}".format(*rgb) for rgb in found))


def _pixels(found: Assessment) -> NDArray[np.uint8]:
    """(pixels, 3) sRGB values of a picture as its target shows it."""
    small = to_display(found.shown(read_image(found.path), _SIDE_PX))
    return np.rint(255 * np.broadcast_to(small, (_SIDE_PX, _SIDE_PX, 3))).astype(np.uint8).reshape(-1, 3)
