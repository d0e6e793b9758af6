"""Curves in a frame, drawn pixel by pixel like all figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.drawing.scales import Pixels, round_ticks
from magiclens.drawing.tiles import MUTED_COLOUR, PAPER_COLOUR, RULE_COLOUR, TEXT_COLOUR, font_of

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

CHART_WIDTH, CHART_HEIGHT = 1000, 520
"""Size of a chart, pixels."""
MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP, MARGIN_BOTTOM = 96, 24, 76, 76
"""Pixels of paper around the frame, for the numbers and names of the axes."""
SHADED_COLOUR = "#eef3ea"
"""Colour of the shaded part of a chart."""
_OVERSAMPLING = 3
"""A chart is drawn at this multiple of its size and then shrunk, which smooths lines."""
_LETTER = 20
"""Size of letters, pixels."""
_ENTRY = 32
"""Height of an entry of the legend, pixels."""


@dataclass(frozen=True)
class Curve:
    """Numbers ``ys`` at the xs of a chart; ``colour`` is hexadecimal RGB."""

    name: str
    ys: FloatArray
    colour: str


@dataclass(frozen=True)
class ChartAxis:
    """Numbers from ``low`` to ``high`` along an edge of the frame."""

    name: str
    low: float
    high: float

    def ticks(self) -> dict[float, str]:
        """Round numbers by position, 0 at ``low`` and 1 at ``high``."""
        return round_ticks(self.low, self.high)


@dataclass(frozen=True)
class Chart:
    """Curves over common ``xs``.

    ``shaded`` says from which x to which the chart is shaded, and what this part is called. At ``marks`` there are
    dotted lines. ``upper`` is the name and the ticks of the upper edge, for x in another unit. ``legend`` says whether
    the legend stands at the upper right, or low in the shaded part, for curves that are high there.
    """

    xs: FloatArray
    curves: Sequence[Curve]
    x: ChartAxis
    y: ChartAxis
    shaded: tuple[float, float, str]
    marks: Sequence[float] = ()
    upper: tuple[str, Mapping[float, str]] = ("", MappingProxyType({}))
    legend: Literal["right", "shaded"] = "right"

    def draw(self) -> Pixels:
        """Draw the chart, (CHART_HEIGHT, CHART_WIDTH, 3)."""
        from PIL import Image, ImageDraw

        image = Image.new("RGB", (_OVERSAMPLING * CHART_WIDTH, _OVERSAMPLING * CHART_HEIGHT), PAPER_COLOUR)
        draw = ImageDraw.Draw(image)
        left, top = self._at(self.x.low, self.y.high)
        right, bottom = self._at(self.x.high, self.y.low)
        start, end = (self._at(x, 0)[0] for x in self.shaded[:2])
        draw.rectangle((start, top, end, bottom), fill=SHADED_COLOUR)
        _write(draw, (start + 8 * _OVERSAMPLING, bottom - 18 * _OVERSAMPLING), self.shaded[2], MUTED_COLOUR, "lm")
        self._draw_axes(draw, left, top, right, bottom)
        for mark in self.marks:
            x = self._at(mark, 0)[0]
            for dot in range(int(top), int(bottom), 12 * _OVERSAMPLING):
                draw.line((x, dot, x, dot + 5 * _OVERSAMPLING), fill=MUTED_COLOUR, width=_OVERSAMPLING)
        for curve in self.curves:
            self._draw_curve(draw, curve)
        low = bottom - (36 + _ENTRY * len(self.curves)) * _OVERSAMPLING
        right_or_shaded = {"right": (right - 340 * _OVERSAMPLING, top + 12 * _OVERSAMPLING), "shaded": (start, low)}
        self._draw_legend(draw, *right_or_shaded[self.legend])
        draw.rectangle((left, top, right, bottom), outline=MUTED_COLOUR, width=_OVERSAMPLING)
        return np.asarray(image.reduce(_OVERSAMPLING))

    def _at(self, x: float, y: float) -> tuple[float, float]:
        """Pixel coordinates, before the picture is shrunk, of a point given in the numbers of the axes."""
        across, up = (x - self.x.low) / (self.x.high - self.x.low), (y - self.y.low) / (self.y.high - self.y.low)
        width, height = CHART_WIDTH - MARGIN_LEFT - MARGIN_RIGHT, CHART_HEIGHT - MARGIN_TOP - MARGIN_BOTTOM
        column, row = MARGIN_LEFT + across * width, CHART_HEIGHT - MARGIN_BOTTOM - up * height
        return _OVERSAMPLING * column, _OVERSAMPLING * row

    def _draw_axes(self, draw: ImageDraw, left: float, top: float, right: float, bottom: float) -> None:
        for position, text in self.y.ticks().items():
            y = bottom + position * (top - bottom)
            draw.line((left, y, right, y), fill=RULE_COLOUR, width=_OVERSAMPLING)
            _write(draw, (left - 10 * _OVERSAMPLING, y), text, MUTED_COLOUR, "rm")
        _write(draw, (8 * _OVERSAMPLING, top - 50 * _OVERSAMPLING), self.y.name, TEXT_COLOUR, "lm")
        # ``out`` is the direction away from the frame: down from the lower edge, up from the upper one
        for (name, ticks), edge, out in (((self.x.name, self.x.ticks()), bottom, 1), (self.upper, top, -1)):
            for position, text in ticks.items():
                x = left + position * (right - left)
                draw.line((x, edge, x, edge + 6 * out * _OVERSAMPLING), fill=MUTED_COLOUR, width=_OVERSAMPLING)
                _write(draw, (x, edge + 20 * out * _OVERSAMPLING), text, MUTED_COLOUR, "mm")
            _write(draw, ((left + right) / 2, edge + 50 * out * _OVERSAMPLING), name, TEXT_COLOUR, "mm")

    def _draw_curve(self, draw: ImageDraw, curve: Curve) -> None:
        points = [self._at(float(x), float(y)) for x, y in zip(self.xs, curve.ys, strict=True)]
        draw.line(points, fill=curve.colour, width=4 * _OVERSAMPLING, joint="curve")
        radius = 5 * _OVERSAMPLING
        for x, y in points:
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=curve.colour)

    def _draw_legend(self, draw: ImageDraw, x: float, y: float) -> None:
        height = _ENTRY * len(self.curves) * _OVERSAMPLING
        if self.legend == "right":
            draw.rectangle((x, y, x + 328 * _OVERSAMPLING, y + height), fill=PAPER_COLOUR)
        for k, curve in enumerate(self.curves):
            line = y + _ENTRY * (k + 0.5) * _OVERSAMPLING
            ends = (x + 8 * _OVERSAMPLING, line, x + 48 * _OVERSAMPLING, line)
            draw.line(ends, fill=curve.colour, width=4 * _OVERSAMPLING)
            _write(draw, (x + 58 * _OVERSAMPLING, line), curve.name, TEXT_COLOUR, "lm")


def _write(draw: ImageDraw, at: tuple[float, float], text: str, colour: str, anchor: str) -> None:
    """Write a line of text; ``anchor`` is which point of it is at ``at``, as Pillow names it."""
    draw.text(at, text, fill=colour, font=font_of(_LETTER * _OVERSAMPLING), anchor=anchor)
