"""Drawings on dark pages: paper and lines change places, hues stay, pictures are left as they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magiclens.drawing.scales import Pixels

DARK_PAPER_COLOUR, DARK_TEXT_COLOUR = "#1d2127", "#e6e9ed"
"""What takes the places of white and black; as of cards and text of dark pages."""
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
"""How light red, green and blue are, in display values (ITU-R BT.601)."""
Box = tuple[int, int, int, int]
"""Left, upper, right and lower edge of a part of a picture, pixels; the part ends before the last two."""


def for_dark_pages(drawing: Pixels, pictures: Sequence[Box] = ()) -> Pixels:
    """A drawing on white paper as it suits a dark page.

    Args:
        drawing: (H, W, 3) in display values.
        pictures: Parts of it that are no lines on paper, but what was photographed or painted, and stay as they are.

    Returns:
        (H, W, 3): the lightness of every colour is turned over, its hue is kept.
    """
    values = drawing.astype(np.float32)
    turned = np.clip(values + 255 - 2 * (values @ _LUMA)[..., None], 0, 255)
    paper, text = (np.array(list(bytes.fromhex(c[1:])), np.float32) for c in (DARK_PAPER_COLOUR, DARK_TEXT_COLOUR))
    dark = np.rint(paper + turned / 255 * (text - paper)).astype(np.uint8)
    for left, upper, right, lower in pictures:
        dark[upper:lower, left:right] = drawing[upper:lower, left:right]
    return dark
