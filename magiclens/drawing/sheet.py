"""Sheets of captioned pictures, drawn pixel by pixel so that equal figures are equal files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.drawing.scales import Pixels, Scale
from magiclens.images.colour import to_display
from magiclens.images.resample import resize

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

PAPER, INK, MUTED, RULE = "#ffffff", "#1c2128", "#5c6670", "#c8ced6"
FINER = 2
"""Pictures with hard edges are painted at this multiple of their size and then shrunk."""
GAP, TEXT, LINE, BAR, LABELS = 28, 24, 40, 20, 76
"""Pixels: between tiles, of a letter, of a line of text, of a colour bar, of the numbers beside it."""

SMALLEST = 11
"""Pixels of the smallest letters."""


@dataclass(frozen=True)
class Tile:
    """A picture (height, width, 3) with a title above, a caption below, and a colour bar at its right."""

    picture: Pixels
    title: str = ""
    caption: str = ""
    scale: Scale | None = None

    @property
    def width(self) -> int:
        """Pixels, colour bar included."""
        return int(self.picture.shape[1]) + (GAP // 2 + BAR + LABELS if self.scale else 0)


def grid(tiles: Sequence[Tile]) -> list[Sequence[Tile]]:
    """Tiles in rows, about as many in each as there are rows."""
    columns = math.ceil(math.sqrt(len(tiles)))
    return [tiles[k : k + columns] for k in range(0, len(tiles), columns)]


def display(linear: FloatArray, side: int) -> Pixels:
    """(side, side, 3) display values of a picture (H, W, C) in linear light."""
    values = np.rint(to_display(resize(linear, (side, side))) * 255).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(values, (side, side, 3)))


def shrunk(picture: FloatArray) -> FloatArray:
    """(S, S, C) float32: means of the blocks of a picture (FINER S, FINER S, C)."""
    rows = np.asarray(np.mean([picture[k::FINER] for k in range(FINER)], axis=0, dtype=np.float32))
    return np.asarray(np.mean([rows[:, k::FINER] for k in range(FINER)], axis=0, dtype=np.float32))


def painted(scale: Scale, values: FloatArray) -> Pixels:
    """(S, S, 3): numbers (FINER S, FINER S) in colours, with smooth edges."""
    return np.rint(shrunk(scale.paint(values).astype(np.float32))).astype(np.uint8)


def sheet(rows: Sequence[Sequence[Tile]]) -> Image:
    """Rows of tiles on white paper. A row has a line for titles or captions when one of its tiles has one."""
    from PIL import Image, ImageDraw

    columns = [max(r[k].width for r in rows if k < len(r)) for k in range(max(map(len, rows)))]
    width = sum(columns) + GAP * (len(columns) + 1)
    image = Image.new("RGB", (width, sum(map(_height, rows)) + GAP), PAPER)
    draw, y = ImageDraw.Draw(image), GAP
    for row in rows:
        below_titles = y + _titles(row)
        for k, tile in enumerate(row):
            _place(image, draw, tile, GAP + sum(columns[:k]) + GAP * k, below_titles)
        y += _height(row)
    return image


def _titles(row: Sequence[Tile]) -> int:
    return LINE if any(tile.title for tile in row) else 0


def _height(row: Sequence[Tile]) -> int:
    captions = LINE if any(tile.caption for tile in row) else 0
    return _titles(row) + max(len(tile.picture) for tile in row) + captions + GAP


def _place(image: Image, draw: ImageDraw, tile: Tile, x: int, y: int) -> None:
    """A tile whose picture has its top-left corner at (x, y)."""
    from PIL import Image

    height, width = tile.picture.shape[:2]
    image.paste(Image.fromarray(tile.picture), (x, y))
    draw.rectangle((x - 1, y - 1, x + width, y + height), outline=RULE)
    _write(draw, x, y - LINE // 2 - 3, tile.title, INK, width)
    _write(draw, x, y + height + LINE // 2, tile.caption, MUTED, width)
    if tile.scale:
        _colour_bar(image, draw, tile.scale, x + width + GAP // 2, y, height)


def _write(draw: ImageDraw, x: int, y: int, text: str, colour: str, width: int) -> None:
    """One line of text whose middle is at y, made smaller where it would be wider than ``width``, then cut."""
    from PIL import ImageFont

    line = " ".join(text.split())
    fonts = (ImageFont.load_default(size) for size in range(TEXT, SMALLEST, -1))
    font = next((font for font in fonts if font.getlength(line) <= width), ImageFont.load_default(SMALLEST))
    fits = next(k for k in range(len(line), -1, -1) if font.getlength(line[:k]) <= width)
    draw.text((x, y), line[:fits], fill=colour, font=font, anchor="lm")


def _colour_bar(image: Image, draw: ImageDraw, scale: Scale, x: int, y: int, height: int) -> None:
    from PIL import Image

    ramp = np.linspace(scale.high, scale.low, height)[:, None].repeat(BAR, axis=1)
    image.paste(Image.fromarray(scale.paint(ramp)), (x, y))
    draw.rectangle((x - 1, y - 1, x + BAR, y + height), outline=RULE)
    for place, text in scale.ticks().items():
        at = y + round((1 - place) * (height - 1))
        draw.line((x + BAR, at, x + BAR + 6, at), fill=MUTED)
        _write(draw, x + BAR + 12, min(max(at, y + TEXT // 2), y + height - TEXT // 2), text, MUTED, LABELS)
