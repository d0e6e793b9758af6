"""Contrast and negatives, in display values as the eye judges them."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.colour import to_display, to_linear


def toned(linear: FloatArray, black: float, white: float, negative: bool) -> FloatArray:
    """(H, W, C) float32, linear light: display values from ``black`` to ``white`` spread over 0..1, then inverted."""
    shown = np.clip((to_display(linear) - black) / (white - black), 0.0, 1.0)
    return to_linear(1 - shown if negative else shown).astype(np.float32)
