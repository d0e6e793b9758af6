"""The look that all pages share."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from magiclens.analysis.tolerances import _COLOURS as CURVE_COLOURS
from magiclens.drawing.tiles import MUTED_COLOUR, PAPER_COLOUR, TEXT_COLOUR
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


def test_colours_are_named_in_one_place() -> None:
    """Pages that are always dark, and colours of glass and paper in drawings of the viewer, are exceptions."""
    own = {"tokens.css", "screen.html", "viewer.css"}
    for path in PACKAGE.rglob("templates/*"):
        if path.suffix in (".css", ".html") and path.name not in own:
            named = re.findall(r"^\s*--[a-z-]+: #", path.read_text(encoding="utf-8"), re.MULTILINE)
            assert named == [], path.name
