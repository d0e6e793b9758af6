"""Texture synthesis around known pixels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from skimage import data

from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import COLOURED, circles, to_display, to_linear
from magiclens.images.texture import synthesize

SIDE = 300


def rng(seed: int = 3) -> np.random.Generator:
    return np.random.default_rng(seed)


def photographed(picture: Callable[[], FloatArray]) -> FloatArray:
    """(400, 400, 1) linear light of a sample picture."""
    return to_linear(picture()[:400, :400, None].astype(np.float32) / 255)


def grass() -> FloatArray:
    return photographed(data.grass)


def gravel() -> FloatArray:
    return photographed(data.gravel)


def discs() -> FloatArray:
    return circles(30, 15, rng(1))


def coloured_discs() -> FloatArray:
    return circles(30, 15, rng(1), colours=COLOURED)


def squares_known() -> BoolArray:
    """(SIDE, SIDE): a quarter is known, one random square of 25 pixels in each block of 50."""
    known = np.zeros((SIDE, SIDE), bool)
    chosen = rng(4)
    for y in range(0, SIDE, 50):
        for x in range(0, SIDE, 50):
            dy, dx = 25 * chosen.integers(2, size=2)
            known[y + dy : y + dy + 25, x + dx : x + dx + 25] = True
    return known


def blank(example: FloatArray) -> tuple[FloatArray, BoolArray]:
    """A picture of which nothing is known."""
    return np.zeros((SIDE, SIDE, example.shape[-1]), np.float32), np.zeros((SIDE, SIDE), bool)


def elsewhere(example: FloatArray) -> FloatArray:
    """(SIDE, SIDE, C): another picture of the same texture: the example mirrored."""
    return np.ascontiguousarray(example[::-1, ::-1][:SIDE, :SIDE])


def jumps(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Differences of display values between vertical neighbours and between horizontal ones."""
    values = to_display(image)
    return np.abs(np.diff(values, axis=0)), np.abs(np.diff(values, axis=1))


def mean_jump(image: FloatArray) -> float:
    return float(np.mean([jump.mean() for jump in jumps(image)]))


def seam(image: FloatArray, known: BoolArray) -> float:
    """Mean difference of display values across the borders of what is known."""
    across = [np.diff(known, axis=axis) for axis in (0, 1)]
    return float(np.concatenate([jump[border] for jump, border in zip(jumps(image), across, strict=True)]).mean())


def random_fill(example: FloatArray, fixed: FloatArray, known: BoolArray) -> FloatArray:
    """Unknown pixels taken from random pixels of the example."""
    pixels = rng().choice(example.reshape(-1, example.shape[-1]), known.shape)
    return np.where(known[..., None], fixed, pixels)


EXAMPLES = [grass, gravel, discs, coloured_discs]


@pytest.mark.parametrize("make", EXAMPLES)
def test_known_pixels_come_back_bit_for_bit_and_all_others_are_the_examples(make: Callable[[], FloatArray]) -> None:
    example, known = make(), squares_known()
    fixed = rng().uniform(0, 1, (SIDE, SIDE, example.shape[-1])).astype(np.float32)
    out = synthesize(example, fixed, known, rng())
    assert out.shape == fixed.shape
    assert out.dtype == np.float32
    assert np.array_equal(out[known], fixed[known])
    palette = {pixel.tobytes() for pixel in example.reshape(-1, example.shape[-1])}
    assert {pixel.tobytes() for pixel in out[~known]} <= palette


@pytest.mark.parametrize("make", EXAMPLES)
def test_brightness_contrast_and_grain_are_the_examples(make: Callable[[], FloatArray]) -> None:
    example = make()
    out = synthesize(example, *blank(example), rng())
    seen, wanted = to_display(out), to_display(example)
    assert seen.mean() == pytest.approx(wanted.mean(), abs=0.1)
    assert seen.std() == pytest.approx(wanted.std(), rel=0.1)
    assert mean_jump(out) == pytest.approx(mean_jump(example), rel=0.2)
    assert mean_jump(random_fill(example, *blank(example))) > 1.5 * mean_jump(example)


@pytest.mark.parametrize("make", [grass, gravel])
def test_the_histogram_is_the_examples(make: Callable[[], FloatArray]) -> None:
    example, shares = make(), np.linspace(0.05, 0.95, 10)
    out = synthesize(example, *blank(example), rng())
    assert np.abs(np.quantile(to_display(out), shares) - np.quantile(to_display(example), shares)).max() < 0.03


def test_every_colour_keeps_its_share() -> None:
    example = coloured_discs()
    out = synthesize(example, *blank(example), rng())
    for ink in COLOURED:
        here, there = ((np.abs(image - np.array(ink, np.float32)).max(-1) < 1e-3).mean() for image in (out, example))
        assert here == pytest.approx(there, abs=0.1)
        assert here > 0.2 * there


@pytest.mark.parametrize("make", EXAMPLES)
def test_the_texture_meets_known_pixels(make: Callable[[], FloatArray]) -> None:
    example, known = make(), squares_known()
    fixed = elsewhere(example)
    out = synthesize(example, fixed, known, rng())
    unaware = synthesize(example, *blank(example), rng())
    pasted = np.where(known[..., None], fixed, unaware)
    least = seam(fixed, known)
    for careless in (pasted, random_fill(example, fixed, known)):
        assert seam(out, known) - least < 0.3 * (seam(careless, known) - least)


def test_tiles_leave_no_seams_where_they_are_laid() -> None:
    example = grass()
    many = [synthesize(example, *blank(example), rng(seed)) for seed in range(8)]
    for axis in (0, 1):
        profile = np.mean([jumps(out)[axis].mean((1 - axis, 2)) for out in many], axis=0)
        assert profile.max() < 1.25 * np.median(profile)


def test_lines_that_end_at_a_gap_are_joined() -> None:
    stripes = np.zeros((120, 120, 1), np.float32)
    stripes[np.arange(120) % 12 < 6] = 1
    known = np.ones((120, 120), bool)
    known[40:80, 40:80] = False
    out = synthesize(stripes, stripes, known, rng())
    assert np.mean(out[~known] == stripes[~known]) > 0.99


def test_the_same_seed_gives_the_same_texture() -> None:
    example = grass()
    first, again, other = (synthesize(example, *blank(example), rng(seed)) for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert np.mean(first != other) > 0.5


def test_what_unknown_pixels_hold_does_not_matter() -> None:
    example, known = gravel(), squares_known()
    fixed = elsewhere(example)
    rubbish = np.where(known[..., None], fixed, np.nan)
    assert np.array_equal(synthesize(example, fixed, known, rng()), synthesize(example, rubbish, known, rng()))


@pytest.mark.parametrize("shape", [(5, 90), (33, 31), (1, 1)])
def test_pictures_smaller_than_a_tile_are_filled_too(shape: tuple[int, int]) -> None:
    example = grass()[:40, :17]
    out = synthesize(example, np.zeros((*shape, 1)), np.zeros(shape, bool), rng())
    assert out.shape == (*shape, 1)
    assert set(out.ravel()) <= set(example.ravel())


def test_where_all_is_known_nothing_changes() -> None:
    fixed = elsewhere(gravel())
    assert np.array_equal(synthesize(gravel(), fixed, np.ones((SIDE, SIDE), bool), rng()), fixed)


def test_a_tiny_example_and_a_picture_of_another_kind_are_refused() -> None:
    fixed, known = blank(grass())
    with pytest.raises(InputError, match="12 x 40 pixels; it needs at least 16 x 16"):
        synthesize(grass()[:40, :12], fixed, known, rng())
    with pytest.raises(ValueError, match="shape"):
        synthesize(coloured_discs(), fixed, known, rng())
