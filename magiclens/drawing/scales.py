"""Colour scales: from numbers to the colours of a figure, and the ticks of its colour bar."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, IntArray

Pixels = NDArray[np.uint8]
"""A picture (H, W, 3) in sRGB display values, row 0 at the top."""

DIVERGING = "053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f"
"""Blue, white, red (RdBu of ColorBrewer): for numbers around a middle that matters."""
BLUE_TO_RED = "26358c 2b6cc4 2fa8d8 57cfa8 a4e05c f2e643 fba431 ea5b20 b31313"
"""The colours of the paper's figure 7."""
GLOW = "100b2e 3b0f6b 6d1d81 a02d7d d3436e f8705c fe9f6d fecf92 fcfdbf"
"""From dark to bright (magma): for numbers whose large values matter."""

_TABLE = 1024
"""Number of entries in the table of colours; more than an 8-bit display can tell apart."""


@dataclass(frozen=True)
class ColourScale:
    """Colours, evenly spread from ``low`` to ``high``.

    ``anchors`` are hexadecimal RGB values, separated by spaces. ``whole`` says that the numbers are counts, so that
    ticks are whole numbers.
    """

    anchors: str
    low: float
    high: float
    whole: bool = False

    @property
    def _anchor_colours(self) -> FloatArray:
        return np.array([list(bytes.fromhex(anchor)) for anchor in self.anchors.split()], np.float32)

    def paint(self, values: FloatArray | IntArray) -> Pixels:
        """Colours (..., 3) of numbers (...); a number outside the scale gets the colour of the nearer end."""
        shades = np.arange(_TABLE) / (_TABLE - 1) * (len(self._anchor_colours) - 1)
        table = [np.interp(shades, np.arange(len(self._anchor_colours)), c) for c in self._anchor_colours.T]
        share = (values - self.low) / (self.high - self.low)
        index = np.clip(np.rint(share * (_TABLE - 1)), 0, _TABLE - 1).astype(np.int16)
        return np.stack([np.rint(channel).astype(np.uint8)[index] for channel in table], axis=-1)

    @property
    def css(self) -> str:
        """The colour bar as a CSS image, ``low`` at the left."""
        return f"linear-gradient(to right, {', '.join(f'#{anchor}' for anchor in self.anchors.split())})"

    def ticks(self) -> dict[float, str]:
        """Ticks of the colour bar, as of ``round_ticks``."""
        return round_ticks(self.low, self.high, self.whole)


def round_ticks(low: float, high: float, whole: bool = False) -> dict[float, str]:
    """About five round numbers between two limits.

    Args:
        low: Lower limit.
        high: Upper limit.
        whole: Whether ticks between whole numbers make no sense.

    Returns:
        The text of each number, by its position: 0 at ``low``, 1 at ``high``.
    """
    step = _round_step((high - low) / 4)
    step = max(step, 1.0) if whole else step
    digits = max(0, -math.floor(math.log10(step)))
    # the tolerance keeps a limit that is a multiple of the step, but for rounding
    numbers = step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    sign = "+" if low < 0 else ""
    # adding 0.0 turns -0.0 into 0.0, which would be written with a minus sign
    return {float((x - low) / (high - low)): f"{x:{sign if x else ''}.{digits}f}" for x in numbers + 0.0}


def _round_step(rough: float) -> float:
    """The largest of ..., 0.1, 0.2, 0.5, 1, 2, 5, ... that is not above ``rough``."""
    power = 10.0 ** math.floor(math.log10(rough))
    return max(f * power for f in (1, 2, 5) if f * power <= rough * (1 + 1e-9))
