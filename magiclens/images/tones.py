"""Contrast and negatives, computed in display values, which are what the eye compares."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.colour import to_display, to_linear


def toned(linear: FloatArray, black: float, white: float, negative: bool) -> FloatArray:
    """Stretch the contrast of a picture, and invert it if wished.

    Args:
        linear: (H, W, C) linear light.
        black: Display value that becomes 0.
        white: Display value that becomes 1.
        negative: Whether the picture is inverted.

    Returns:
        (H, W, C) float32, linear light.
    """
    shown = np.clip((to_display(linear) - black) / (white - black), 0.0, 1.0)
    return to_linear(1 - shown if negative else shown).astype(np.float32)
