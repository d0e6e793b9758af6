"""Colour scales: from numbers to the colours of a figure, and the labels of its colour bar."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, IntArray

Pixels = NDArray[np.uint8]

DIVERGING = "053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f"
"""Blue, white, red (ColorBrewer's RdBu): for numbers around a middle that matters."""
BLUE_TO_RED = "26358c 2b6cc4 2fa8d8 57cfa8 a4e05c f2e643 fba431 ea5b20 b31313"
"""As the paper's figure 7."""
GLOW = "100b2e 3b0f6b 6d1d81 a02d7d d3436e f8705c fe9f6d fecf92 fcfdbf"
"""From dark to bright (magma): for numbers whose large values matter."""


@dataclass(frozen=True)
class Scale:
    """Colours, evenly spread from ``low`` to ``high``. ``anchors`` are hexadecimal RGB values; ``whole``: it counts."""

    anchors: str
    low: float
    high: float
    whole: bool = False

    @property
    def _anchor_colours(self) -> FloatArray:
        return np.array([list(bytes.fromhex(anchor)) for anchor in self.anchors.split()], np.float32)

    def paint(self, values: FloatArray | IntArray) -> Pixels:
        """(..., 3) uint8 colours of numbers (...); those outside get the colour of the nearer end."""
        shades = np.arange(1024) / 1023 * (len(self._anchor_colours) - 1)
        table = [np.interp(shades, np.arange(len(self._anchor_colours)), c) for c in self._anchor_colours.T]
        share = (values - self.low) / (self.high - self.low)
        index = np.clip(np.rint(share * 1023), 0, 1023).astype(np.int16)
        return np.stack([np.rint(channel).astype(np.uint8)[index] for channel in table], axis=-1)

    @property
    def css(self) -> str:
        """The colour bar as a CSS image, ``low`` at the left."""
        return f"linear-gradient(to right, {', '.join(f'#{anchor}' for anchor in self.anchors.split())})"

    def ticks(self) -> dict[float, str]:
        """Round numbers within the scale and how to write them: by place, 0 at ``low`` and 1 at ``high``."""
        step = _round_step((self.high - self.low) / 4)
        step = max(step, 1.0) if self.whole else step
        digits = max(0, -math.floor(math.log10(step)))
        numbers = step * np.arange(math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9) + 1)
        sign = "+" if self.low < 0 else ""
        return {
            float((x - self.low) / (self.high - self.low)): f"{x:{sign if x else ''}.{digits}f}" for x in numbers + 0.0
        }


def _round_step(rough: float) -> float:
    """The largest of ..., 0.1, 0.2, 0.5, 1, 2, 5, ... that is not above ``rough``."""
    power = 10.0 ** math.floor(math.log10(rough))
    return max(f * power for f in (1, 2, 5) if f * power <= rough * (1 + 1e-9))
