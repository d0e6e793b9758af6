"""Captioned pictures in rows, drawn pixel by pixel so that equal figures are equal files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.drawing.dark import Box
from magiclens.drawing.scales import ColourScale, Pixels
from magiclens.images.colour import to_display
from magiclens.images.resample import resize

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont

PAPER_COLOUR = "#ffffff"
TEXT_COLOUR = "#1c2128"
MUTED_COLOUR = "#5c6670"
"""Colour of captions, ticks and axes."""
RULE_COLOUR = "#c8ced6"
"""Colour of frames and grid lines."""

OVERSAMPLING = 2
"""Pictures with hard edges are painted at this multiple of their size and then shrunk."""
TILE_GAP = 28
"""Pixels between tiles, and around all of them."""
TEXT_LINE = 40
"""Height of a line of text, pixels."""
TICK_WIDTH = 76
"""Pixels beside a colour bar for its numbers."""
_LETTER, _SMALLEST_LETTER = 24, 11
"""Usual and smallest size of letters, pixels."""
_BAR = 20
"""Width of a colour bar, pixels."""


@dataclass(frozen=True)
class Tile:
    """A picture (H, W, 3) with a title above, a caption below, and a colour bar at its right.

    ``drawn`` says that it is lines on paper, as charts are, which look otherwise on dark pages.
    """

    picture: Pixels
    title: str = ""
    caption: str = ""
    scale: ColourScale | None = None
    drawn: bool = False

    @property
    def width(self) -> int:
        """Pixels, colour bar included."""
        return int(self.picture.shape[1]) + (TILE_GAP // 2 + _BAR + TICK_WIDTH if self.scale else 0)


def wrap_tiles(tiles: Sequence[Tile]) -> list[Sequence[Tile]]:
    """Put tiles into rows, about as many in each as there are rows."""
    columns = math.ceil(math.sqrt(len(tiles)))
    return [tiles[k : k + columns] for k in range(0, len(tiles), columns)]


def side_of_tiles(rows: int) -> int:
    """Pixels along the side of pictures that are compared in so many rows."""
    return 400 if rows <= 4 else 280


def titled_rows(titles: Sequence[str], rows: Sequence[Sequence[tuple[Pixels, str]]]) -> list[list[Tile]]:
    """Rows of pictures with captions below them; the titles of the columns stand above the first row.

    Args:
        titles: One for each column.
        rows: Pictures (H, W, 3) with their captions.
    """
    blank = [""] * len(titles)
    return [
        [
            Tile(picture, title, caption)
            for title, (picture, caption) in zip(titles if k == 0 else blank, row, strict=True)
        ]
        for k, row in enumerate(rows)
    ]


def to_pixels(linear: FloatArray, side: int) -> Pixels:
    """Display values (side, side, 3) of a picture (H, W, C) in linear light; one channel becomes grey."""
    values = np.rint(to_display(resize(linear, (side, side))) * 255).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(values, (side, side, 3)))


def mean_of_blocks(picture: FloatArray) -> FloatArray:
    """Shrink a picture (k S, k S, C) to (S, S, C) float32 by the mean of each block, k being ``OVERSAMPLING``."""
    rows = np.asarray(np.mean([picture[k::OVERSAMPLING] for k in range(OVERSAMPLING)], axis=0, dtype=np.float32))
    return np.asarray(np.mean([rows[:, k::OVERSAMPLING] for k in range(OVERSAMPLING)], axis=0, dtype=np.float32))


def paint_smoothly(scale: ColourScale, values: FloatArray) -> Pixels:
    """Paint numbers (k S, k S) as a picture (S, S, 3) with smooth edges, k being ``OVERSAMPLING``."""
    return np.rint(mean_of_blocks(scale.paint(values).astype(np.float32))).astype(np.uint8)


def render_rows(rows: Sequence[Sequence[Tile]]) -> Image:
    """Draw rows of tiles on white paper; a row has a line for titles or captions if one of its tiles has one."""
    from PIL import Image, ImageDraw

    columns = _columns(rows)
    width = sum(columns) + TILE_GAP * (len(columns) + 1)
    image = Image.new("RGB", (width, sum(map(_height, rows)) + TILE_GAP), PAPER_COLOUR)
    draw = ImageDraw.Draw(image)
    for tile, corner in _placed(rows):
        _draw_tile(image, draw, tile, corner)
    return image


@cache
def font_of(size: int) -> FreeTypeFont:
    """The letters of all drawings, of a size in pixels."""
    from PIL import ImageFont

    return ImageFont.load_default(size)  # type: ignore[return-value]  # bitmaps are for Pillow without FreeType


def picture_boxes(rows: Sequence[Sequence[Tile]]) -> list[Box]:
    """Where pictures and colour bars are in what ``render_rows`` draws; all else, charts too, is drawn on paper."""
    found: list[Box] = []
    for tile, (x, y) in _placed(rows):
        height, width = tile.picture.shape[:2]
        if not tile.drawn:
            found.append((x, y, x + width, y + height))
        if tile.scale:
            found.append((x + width + TILE_GAP // 2, y, x + width + TILE_GAP // 2 + _BAR, y + height))
    return found


def _placed(rows: Sequence[Sequence[Tile]]) -> Iterator[tuple[Tile, tuple[int, int]]]:
    """Tiles with the upper left corners of their pictures."""
    columns, y = _columns(rows), TILE_GAP
    for row in rows:
        for k, tile in enumerate(row):
            yield tile, (TILE_GAP + sum(columns[:k]) + TILE_GAP * k, y + _titles(row))
        y += _height(row)


def _columns(rows: Sequence[Sequence[Tile]]) -> list[int]:
    """Their widths."""
    return [max(r[k].width for r in rows if k < len(r)) for k in range(max(map(len, rows)))]


def _titles(row: Sequence[Tile]) -> int:
    return TEXT_LINE if any(tile.title for tile in row) else 0


def _height(row: Sequence[Tile]) -> int:
    captions = TEXT_LINE if any(tile.caption for tile in row) else 0
    return _titles(row) + max(len(tile.picture) for tile in row) + captions + TILE_GAP


def _draw_tile(image: Image, draw: ImageDraw, tile: Tile, corner: tuple[int, int]) -> None:
    """Draw a tile; ``corner`` is the top left corner of its picture."""
    from PIL import Image

    x, y = corner
    height, width = tile.picture.shape[:2]
    image.paste(Image.fromarray(tile.picture), corner)
    draw.rectangle((x - 1, y - 1, x + width, y + height), outline=RULE_COLOUR)
    _write(draw, (x, y - TEXT_LINE // 2 - 3), tile.title, TEXT_COLOUR, width)
    _write(draw, (x, y + height + TEXT_LINE // 2), tile.caption, MUTED_COLOUR, width)
    if tile.scale:
        _draw_colour_bar(image, draw, tile.scale, (x + width + TILE_GAP // 2, y), height)


def _write(draw: ImageDraw, at: tuple[int, int], text: str, colour: str, width: int) -> None:
    """Write one line whose middle is at ``at``; it is made smaller to fit into ``width``, and cut if that fails."""
    line = " ".join(text.split())
    fonts = (font_of(size) for size in range(_LETTER, _SMALLEST_LETTER, -1))
    font = next((font for font in fonts if font.getlength(line) <= width), font_of(_SMALLEST_LETTER))
    fits = next(k for k in range(len(line), -1, -1) if font.getlength(line[:k]) <= width)
    draw.text(at, line[:fits], fill=colour, font=font, anchor="lm")


def _draw_colour_bar(image: Image, draw: ImageDraw, scale: ColourScale, corner: tuple[int, int], height: int) -> None:
    """Draw an upright colour bar, high numbers at the top."""
    from PIL import Image

    x, y = corner
    ramp = np.linspace(scale.high, scale.low, height)[:, None].repeat(_BAR, axis=1)
    image.paste(Image.fromarray(scale.paint(ramp)), corner)
    draw.rectangle((x - 1, y - 1, x + _BAR, y + height), outline=RULE_COLOUR)
    for position, text in scale.ticks().items():
        tick = y + round((1 - position) * (height - 1))
        draw.line((x + _BAR, tick, x + _BAR + 6, tick), fill=MUTED_COLOUR)
        # numbers at the ends move inward, so that they do not stick out over the picture's edges
        middle = min(max(tick, y + _LETTER // 2), y + height - _LETTER // 2)
        _write(draw, (x + _BAR + 12, middle), text, MUTED_COLOUR, TICK_WIDTH)
