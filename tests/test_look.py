"""The look that all pages share."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from magiclens.analysis.tolerances import _COLOURS as CURVE_COLOURS
from magiclens.drawing.dark import DARK_PAPER_COLOUR, DARK_TEXT_COLOUR, for_dark_pages
from magiclens.drawing.scales import GLOW, ColourScale
from magiclens.drawing.tiles import MUTED_COLOUR, PAPER_COLOUR, TEXT_COLOUR, Tile, picture_boxes, render_rows
from magiclens.images import to_linear
from magiclens.pages.templating import colours

PACKAGE = Path(__file__).parent.parent / "magiclens"
TEXTS = ("ink", "muted", "accent", "edge", "green", "amber", "red")
READABLE = 4.5
"""Least contrast of text, WCAG 2.2, level AA."""
SEEN = 3
"""Least contrast of lines."""


def luminance(colour: str) -> float:
    digits = colour[1:] if len(colour) == 7 else "".join(digit * 2 for digit in colour[1:])
    light = to_linear(np.array([int(digits[k : k + 2], 16) for k in (0, 2, 4)]) / 255)
    return float(light @ (0.2126, 0.7152, 0.0722))


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_contrast_of_black_on_white_is_21() -> None:
    assert contrast("#000", "#ffffff") == pytest.approx(21)


def test_text_is_readable_in_light_in_dark_and_on_paper() -> None:
    assert len(colours()) == 3
    assert len({found["paper"] for found in colours().values()}) == 3
    for found in colours().values():
        for text, ground in product(TEXTS, ("paper", "card")):
            assert contrast(found[text], found[ground]) > READABLE, (text, ground)
        assert contrast(found["on-accent"], found["accent"]) > READABLE


def test_charts_have_the_colours_of_light_pages() -> None:
    """Figures are drawn pixel by pixel, so their colours cannot come from the style sheet."""
    light = colours()["light"]
    assert (light["card"], light["ink"]) == (PAPER_COLOUR, TEXT_COLOUR)
    assert contrast(MUTED_COLOUR, PAPER_COLOUR) > READABLE
    for curve in CURVE_COLOURS:
        assert contrast(curve, PAPER_COLOUR) > SEEN, curve


def darkened(colour: str) -> str:
    pixel = np.array([[list(bytes.fromhex(colour[1:]))]], np.uint8)
    return f"#{bytes(for_dark_pages(pixel)[0, 0]).hex()}"


def test_charts_on_dark_pages_have_their_colours_and_curves_keep_their_hues() -> None:
    dark = colours()["dark"]
    assert (dark["card"], dark["ink"]) == (DARK_PAPER_COLOUR, DARK_TEXT_COLOUR)
    assert (darkened("#ffffff"), darkened("#000000")) == (DARK_PAPER_COLOUR, DARK_TEXT_COLOUR)
    for text in (TEXT_COLOUR, MUTED_COLOUR):
        assert contrast(darkened(text), DARK_PAPER_COLOUR) > READABLE
    for curve in CURVE_COLOURS:
        assert contrast(darkened(curve), DARK_PAPER_COLOUR) > SEEN, curve
        strongest = [max(range(3), key=bytes.fromhex(each[1:]).__getitem__) for each in (curve, darkened(curve))]
        assert strongest[0] == strongest[1], curve


def test_on_dark_pages_lines_change_and_pictures_stay() -> None:
    picture, chart = np.full((40, 60, 3), 200, np.uint8), np.full((40, 60, 3), 255, np.uint8)
    scale = ColourScale(GLOW, 0.0, 1.0)
    rows = [[Tile(picture, "A title", "a caption", scale), Tile(chart, drawn=True)]]
    whole, boxes = np.asarray(render_rows(rows)), picture_boxes(rows)
    dark, kept = for_dark_pages(whole, boxes), np.zeros(whole.shape[:2], bool)
    for left, upper, right, lower in boxes:
        kept[upper:lower, left:right] = True
    assert [(right - left, lower - upper) for left, upper, right, lower in boxes] == [(60, 40), (20, 40)]
    assert (dark[kept] == whole[kept]).all()
    assert (whole[boxes[0][1] : boxes[0][3], boxes[0][0] : boxes[0][2]] == 200).all(), "the box is the picture's place"
    paper = (whole == 255).all(axis=-1) & ~kept
    assert paper.sum() > 60 * 40
    assert (dark[paper] == tuple(bytes.fromhex(DARK_PAPER_COLOUR[1:]))).all()


def test_colours_are_named_in_one_place() -> None:
    """Pages that are always dark, and colours of glass and paper in drawings of the viewer, are exceptions."""
    own = {"tokens.css", "screen.html", "viewer.css"}
    for path in PACKAGE.rglob("templates/*"):
        if path.suffix in (".css", ".html") and path.name not in own:
            named = re.findall(r"^\s*--[a-z-]+: #", path.read_text(encoding="utf-8"), re.MULTILINE)
            assert named == [], path.name
