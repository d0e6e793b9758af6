"""Curves in a frame, drawn pixel by pixel like all figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.drawing.scales import GLOW, Pixels, Scale
from magiclens.drawing.sheet import INK, MUTED, PAPER, RULE

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

WIDTH, HEIGHT = 1000, 520
LEFT, RIGHT, TOP, BOTTOM = 96, 24, 76, 76
"""Pixels of paper around the frame, for the axes' numbers and names."""
FINER = 3
"""Drawn at this multiple of the size and then shrunk, which smooths lines."""
TEXT = 20
SHADE = "#eef3ea"


@dataclass(frozen=True)
class Curve:
    """ys: numbers at the chart's xs. colour: hexadecimal RGB."""

    name: str
    ys: FloatArray
    colour: str


@dataclass(frozen=True)
class Axis:
    """Numbers from ``low`` to ``high`` along an edge of the frame."""

    name: str
    low: float
    high: float

    def ticks(self) -> dict[float, str]:
        """By place, 0 at ``low`` and 1 at ``high``."""
        return Scale(GLOW, self.low, self.high).ticks()


@dataclass(frozen=True)
class Chart:
    """Curves over common xs. upper: name and ticks of the upper edge, for x in another unit.

    shaded: up to which x, and what that is. marks: xs with a dotted line.
    """

    xs: FloatArray
    curves: Sequence[Curve]
    x: Axis
    y: Axis
    upper: tuple[str, Mapping[float, str]]
    shaded: tuple[float, str]
    marks: Sequence[float]

    def draw(self) -> Pixels:
        """(HEIGHT, WIDTH, 3)."""
        from PIL import Image, ImageDraw

        image = Image.new("RGB", (FINER * WIDTH, FINER * HEIGHT), PAPER)
        draw = ImageDraw.Draw(image)
        left, top = self._at(self.x.low, self.y.high)
        right, bottom = self._at(self.x.high, self.y.low)
        draw.rectangle((left, top, self._at(self.shaded[0], 0)[0], bottom), fill=SHADE)
        self._write(draw, left + 8 * FINER, bottom - 18 * FINER, self.shaded[1], MUTED, "lm")
        self._axes(draw, left, top, right, bottom)
        for mark in self.marks:
            x = self._at(mark, 0)[0]
            for dot in range(int(top), int(bottom), 12 * FINER):
                draw.line((x, dot, x, dot + 5 * FINER), fill=MUTED, width=FINER)
        for curve in self.curves:
            self._curve(draw, curve)
        self._legend(draw, right - 340 * FINER, top + 12 * FINER)
        draw.rectangle((left, top, right, bottom), outline=MUTED, width=FINER)
        return np.asarray(image.reduce(FINER))

    def _at(self, x: float, y: float) -> tuple[float, float]:
        """Where a point lies in the picture."""
        across, up = (x - self.x.low) / (self.x.high - self.x.low), (y - self.y.low) / (self.y.high - self.y.low)
        wide, tall = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
        return FINER * (LEFT + across * wide), FINER * (HEIGHT - BOTTOM - up * tall)

    def _axes(self, draw: ImageDraw, left: float, top: float, right: float, bottom: float) -> None:
        for place, text in self.y.ticks().items():
            y = bottom + place * (top - bottom)
            draw.line((left, y, right, y), fill=RULE, width=FINER)
            self._write(draw, left - 10 * FINER, y, text, MUTED, "rm")
        self._write(draw, 8 * FINER, top - 50 * FINER, self.y.name, INK, "lm")
        for (name, ticks), edge, out in (((self.x.name, self.x.ticks()), bottom, 1), (self.upper, top, -1)):
            for place, text in ticks.items():
                x = left + place * (right - left)
                draw.line((x, edge, x, edge + 6 * out * FINER), fill=MUTED, width=FINER)
                self._write(draw, x, edge + 20 * out * FINER, text, MUTED, "mm")
            self._write(draw, (left + right) / 2, edge + 50 * out * FINER, name, INK, "mm")

    def _curve(self, draw: ImageDraw, curve: Curve) -> None:
        points = [self._at(float(x), float(y)) for x, y in zip(self.xs, curve.ys, strict=True)]
        draw.line(points, fill=curve.colour, width=4 * FINER, joint="curve")
        for x, y in points:
            draw.ellipse((x - 5 * FINER, y - 5 * FINER, x + 5 * FINER, y + 5 * FINER), fill=curve.colour)

    def _legend(self, draw: ImageDraw, x: float, y: float) -> None:
        draw.rectangle((x, y, x + 328 * FINER, y + 32 * len(self.curves) * FINER), fill=PAPER)
        for k, curve in enumerate(self.curves):
            line = y + (16 + 32 * k) * FINER
            draw.line((x + 8 * FINER, line, x + 48 * FINER, line), fill=curve.colour, width=4 * FINER)
            self._write(draw, x + 58 * FINER, line, curve.name, INK, "lm")

    def _write(self, draw: ImageDraw, x: float, y: float, text: str, colour: str, anchor: str) -> None:
        from PIL import ImageFont

        draw.text((x, y), text, fill=colour, font=ImageFont.load_default(TEXT * FINER), anchor=anchor)
