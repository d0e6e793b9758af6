"""Readable text as a picture: bold black letters on white paper, as large as a box allows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.raster import coverage

TextBox = tuple[float, float, float, float]
"""Left, top, right and bottom of the text, as shares 0..1 of the picture's side."""

_MARGIN = 0.06
"""Margin of the default box, as a share of the picture's side."""
_SPACE = 0.4
"""Space between two words of a line, in em (the size of the font)."""
_LEADING = 1.15
"""Distance of two base lines, in em."""
_FLATTENING = 64
"""Factor by which outlines are enlarged before matplotlib flattens their curves, so that these stay smooth."""


@dataclass(frozen=True)
class _Word:
    """One word: its outlines in em, x from the left edge of the ink, y down from the base line; and their extents."""

    outlines: tuple[FloatArray, ...]
    width: float
    top: float
    bottom: float


_Line = tuple[_Word, ...]


def text(words: str, size_px: int, box: TextBox = (_MARGIN, _MARGIN, 1 - _MARGIN, 1 - _MARGIN)) -> FloatArray:
    """Draw a text, broken into centred lines so that its letters are as large as possible.

    Args:
        words: The text; its line breaks are kept.
        size_px: Side of the picture.
        box: Where the text goes.

    Returns:
        (size_px, size_px, 1) float32, linear light.

    Raises:
        ValueError: The text is empty or has letters that are not in the font, or the box is not inside the picture.
    """
    check_words(words)
    check_box(box)
    lines = _largest([_words(line) for line in words.strip().splitlines()], box)
    outlines = [outline * size_px for outline in _placed(lines, box)]
    ink = coverage(outlines, (size_px, size_px), holes=True)
    return np.asarray(1 - ink[..., None], np.float32)


def check_words(words: str) -> None:
    """Raise ValueError if a text is empty or has letters that are not in the font."""
    from matplotlib.ft2font import FT2Font

    font = FT2Font(str(font_file()))
    letters = "".join(words.split())
    unknown = [letter for letter in letters if not font.get_char_index(ord(letter))]
    if unknown:
        raise ValueError(f"the font has no {unknown[0]!r}; write the text in other letters")
    if not any(_word(word).outlines for word in words.split()):
        raise ValueError("the text is empty; write at least one word")


def check_box(box: Sequence[float]) -> None:
    """Raise ValueError if left, top, right and bottom are not those of a box inside the picture."""
    left, top, right, bottom = box
    if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1):
        raise ValueError("write left, top, right and bottom of a box inside the square, such as [10%, 10%, 90%, 50%]")


def font_file() -> Path:
    """The font that comes with matplotlib, so that text looks the same everywhere."""
    import matplotlib

    return Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans-Bold.ttf")


def _words(line: str) -> _Line:
    """The words of a line, without those that have no ink."""
    return tuple(word for word in map(_word, line.split()) if word.outlines)


def _word(letters: str) -> _Word:
    """One word with its kerning."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.path import Path as Curves
    from matplotlib.textpath import TextToPath
    from matplotlib.transforms import Affine2D

    vertices, codes = TextToPath().get_text_path(FontProperties(fname=font_file()), letters)
    if len(vertices) == 0:
        return _Word((), 0.0, 0.0, 0.0)
    per_em = TextToPath.FONT_SCALE * _FLATTENING
    polygons = Curves(vertices, codes).to_polygons(Affine2D().scale(_FLATTENING, -_FLATTENING))
    outlines = [np.asarray(polygon) / per_em for polygon in polygons]
    (left, top), (right, bottom) = (bound(np.concatenate(outlines), axis=0) for bound in (np.min, np.max))
    return _Word(tuple(outline - (left, 0) for outline in outlines), right - left, top, bottom)


def _largest(lines: Sequence[_Line], box: TextBox) -> Sequence[_Line]:
    """The lines, broken so that letters are as large as possible in the box; of several ways the narrowest."""
    return max(_wrappings(lines), key=lambda wrapped: _scale(wrapped, box))


def _wrappings(lines: Sequence[_Line]) -> Iterator[Sequence[_Line]]:
    """All ways to break the lines greedily at one width: from the widest word's width to no break at all."""
    width = max(word.width for line in lines for word in line)
    while True:
        wrapped = [_wrap(line, width) for line in lines]
        yield [line for broken in wrapped for line in broken]
        wider = [_width((*line, after[0])) for broken in wrapped for line, after in pairwise(broken)]
        if not wider:
            return
        width = min(wider)


def _wrap(words: _Line, width: float) -> list[_Line]:
    """One line, broken greedily into lines of at most this width; an empty line stays."""
    broken: list[_Line] = [()]
    for word in words:
        longer = (*broken[-1], word)
        if _width(longer) <= width:
            broken[-1] = longer
        else:
            broken.append((word,))
    return broken


def _width(line: _Line) -> float:
    return sum(word.width for word in line) + _SPACE * max(len(line) - 1, 0)


def _extents(lines: Sequence[_Line]) -> tuple[float, float, float]:
    """Width, top and bottom of the ink in em, y down from the first base line."""
    tops = [k * _LEADING + word.top for k, line in enumerate(lines) for word in line]
    bottoms = [k * _LEADING + word.bottom for k, line in enumerate(lines) for word in line]
    return max(map(_width, lines)), min(tops), max(bottoms)


def _scale(lines: Sequence[_Line], box: TextBox) -> float:
    """Size of the font, as a share of the square, at which the lines just fit into the box."""
    width, top, bottom = _extents(lines)
    return min((box[2] - box[0]) / width, (box[3] - box[1]) / (bottom - top))


def _placed(lines: Sequence[_Line], box: TextBox) -> Iterator[FloatArray]:
    """The outlines in the middle of the box, as shares of the picture's side."""
    scale = _scale(lines, box)
    _, top, bottom = _extents(lines)
    middle = np.array([box[0] + box[2], box[1] + box[3]]) / 2
    for k, line in enumerate(lines):
        pen = np.array([-_width(line) / 2, k * _LEADING - (top + bottom) / 2])
        for word in line:
            for outline in word.outlines:
                yield (outline + pen) * scale + middle
            pen[0] += word.width + _SPACE
