"""Text as a picture: readable, inside its box and as large as the box lets it be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import label

from magiclens.contract.artifacts import FloatArray
from magiclens.images import resize
from magiclens.images.text import TextBox, text

QUESTION = "Who was the first president of the USA?"
SIZE = 240


def ink(picture: FloatArray) -> FloatArray:
    """(H, W) bool: more black than white."""
    return picture[..., 0] < 0.5


def runs(marked: FloatArray) -> list[tuple[int, int]]:
    """Starts and ends of the stretches of a (n,) bool array that are True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked, [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def lines(picture: FloatArray) -> list[tuple[int, int]]:
    """Rows of each line of a text whose lines do not touch."""
    return runs(ink(picture).any(1))


def test_text_is_black_on_white_in_linear_light() -> None:
    picture = text("Hi", SIZE)
    assert picture.shape == (SIZE, SIZE, 1)
    assert picture.dtype == np.float32
    assert picture.min() == pytest.approx(0, abs=1e-6)
    assert picture.max() == 1
    assert (picture >= 0).all()


@pytest.mark.parametrize(("letter", "holes"), [("o", 1), ("A", 1), ("8", 2), ("B", 2), ("%", 2), ("I", 0), ("?", 0)])
def test_holes_in_letters_stay_open(letter: str, holes: int) -> None:
    _, regions = label(~ink(text(letter, SIZE)))
    assert regions - 1 == holes


def test_the_share_of_ink_is_the_same_at_any_size() -> None:
    picture = text(QUESTION, 400)
    assert np.abs(resize(picture, (100, 100)) - text(QUESTION, 100)).max() < 0.01


def test_the_same_words_give_the_same_pixels() -> None:
    assert np.array_equal(text(QUESTION, SIZE), text(QUESTION, SIZE))


@pytest.mark.parametrize("words", [QUESTION, "42", "Incomprehensibilities", "a\nb\nc\nd\ne"])
@pytest.mark.parametrize("box", [(0.0, 0.0, 1.0, 1.0), (0.1, 0.05, 0.9, 0.5), (0.7, 0.1, 0.9, 0.95)])
def test_text_fits_its_box_and_cannot_be_larger(words: str, box: TextBox) -> None:
    marked = text(words, SIZE, box)[..., 0] < 1 - 1e-4
    rows, columns = np.flatnonzero(marked.any(1)), np.flatnonzero(marked.any(0))
    left, top, right, bottom = np.array(box) * SIZE
    assert columns[0] >= left - 1
    assert columns[-1] <= right
    assert rows[0] >= top - 1
    assert rows[-1] <= bottom
    free = [right - left - (columns[-1] + 1 - columns[0]), bottom - top - (rows[-1] + 1 - rows[0])]
    assert min(free) < 1
    assert (columns[0] + columns[-1] + 1) / 2 == pytest.approx((left + right) / 2, abs=1)
    assert (rows[0] + rows[-1] + 1) / 2 == pytest.approx((top + bottom) / 2, abs=1)


def test_the_usual_box_leaves_a_margin_all_round() -> None:
    picture = text("42", 100)
    margins = np.concatenate([picture[:5], picture[-5:], picture[:, :5].swapaxes(0, 1), picture[:, -5:].swapaxes(0, 1)])
    assert (margins == 1).all()


def test_a_long_text_is_broken_into_lines_where_that_makes_it_larger() -> None:
    assert len(lines(text(QUESTION, SIZE))) == 5
    assert len(lines(text(QUESTION, SIZE, (0.0, 0.4, 1.0, 0.6)))) == 2
    assert len(lines(text(QUESTION, SIZE, (0.0, 0.45, 1.0, 0.5)))) == 1


def test_of_lines_as_large_the_balanced_ones_are_taken() -> None:
    picture = text("no no no no", SIZE, (0.0, 0.35, 1.0, 0.65))
    first, second = (runs(ink(picture[top:bottom]).any(0)) for top, bottom in lines(picture))
    assert len(first) == len(second) == 4
    assert np.abs(np.array(first) - np.array(second)).max() <= 1


def test_line_breaks_are_kept() -> None:
    wide = (0.0, 0.4, 1.0, 0.6)
    assert len(lines(text("no no", SIZE, wide))) == 1
    assert len(lines(text("no\nno", SIZE, wide))) == 2


def test_an_empty_line_between_two_is_kept() -> None:
    close, apart = (lines(text(words, SIZE)) for words in ("no\nno\nno", "no\n\nno"))
    assert len(apart) == 2
    assert apart[1][0] - apart[0][0] == pytest.approx(close[2][0] - close[0][0], abs=1)


def test_space_around_the_words_does_not_matter() -> None:
    assert np.array_equal(text("  no   no\n", SIZE), text("no no", SIZE))


def test_dollars_are_letters_like_others() -> None:
    assert len(runs(ink(text("$x$", SIZE)).any(0))) == 3


@pytest.mark.parametrize("words", ["", " \n\t", "\u200b"])
def test_a_text_without_ink_is_refused(words: str) -> None:
    with pytest.raises(ValueError, match="the text is empty; write at least one word"):
        text(words, SIZE)


def test_a_letter_that_the_font_has_not_is_named() -> None:
    with pytest.raises(ValueError, match="the font has no '谁'"):
        text("Who is 谁?", SIZE)


@pytest.mark.parametrize(
    "box", [(0.5, 0, 0.5, 1), (0, 0.6, 1, 0.4), (-0.1, 0, 1, 1), (0, 0, 1, 1.1), (0, 0, float("nan"), 1)]
)
def test_a_box_that_is_none_is_refused(box: TextBox) -> None:
    with pytest.raises(ValueError, match="write left, top, right and bottom of a box inside the square"):
        text("no", SIZE, box)
