"""Filling gaps smoothly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from skimage import data

from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.images import psnr_db, to_display, to_linear
from magiclens.images.inpaint import inpaint

LEVEL = 1 / 255


def noise(*shape: int) -> FloatArray:
    return np.random.default_rng(1).uniform(0, 1, shape).astype(np.float32)


def with_holes(rows: int, columns: int, share: float = 0.6) -> BoolArray:
    """(rows, columns), False in random squares of 20 to 40 pixels until only ``share`` of the picture is known."""
    rng = np.random.default_rng(2)
    known = np.ones((rows, columns), bool)
    while known.mean() > share:
        side = int(rng.integers(20, 41))
        y, x = (int(rng.integers(length - side)) for length in (rows, columns))
        known[y : y + side, x : x + side] = False
    return known


def photograph() -> FloatArray:
    """(256, 256, 3) linear light."""
    return to_linear(data.astronaut()[::2, ::2].astype(np.float32) / 255)


@pytest.mark.parametrize("channels", [1, 3])
def test_known_pixels_come_back_bit_for_bit_and_the_argument_is_not_touched(channels: int) -> None:
    image, known = noise(70, 90, channels), with_holes(70, 90)
    before = image.copy()
    out = inpaint(image, known)
    assert out.dtype == image.dtype
    assert np.array_equal(out[known], image[known])
    assert not np.array_equal(out, image)
    assert np.array_equal(image, before)


def test_a_plain_picture_stays_plain() -> None:
    out = inpaint(np.full((61, 47, 3), 0.3, np.float32), with_holes(61, 47, 0.3))
    assert to_display(out) == pytest.approx(float(to_display(np.array(0.3))), abs=0.01 * LEVEL)


def test_a_linear_ramp_of_display_values_is_continued() -> None:
    y, x = np.mgrid[0:120, 0:150] / 150
    ramp = np.stack([x, 0.1 + 0.5 * y + 0.2 * x], axis=-1).astype(np.float32)
    known = np.zeros((120, 150), bool)
    known[::40] = known[:, ::37] = known[-1] = known[:, -1] = True
    out = to_display(inpaint(to_linear(ramp), known))
    assert np.abs(out - ramp).max() < LEVEL


def test_every_filled_pixel_is_the_mean_of_its_neighbours() -> None:
    known = with_holes(256, 256)
    out = to_display(inpaint(photograph(), known))
    padded = np.pad(out, ((1, 1), (1, 1), (0, 0)), mode="edge")
    mean = (padded[2:, 1:-1] + padded[:-2, 1:-1] + padded[1:-1, 2:] + padded[1:-1, :-2]) / 4
    assert np.abs(out - mean)[~known].max() < 0.5 * LEVEL


def test_a_photograph_is_restored_better_than_by_the_nearest_known_pixels() -> None:
    image, known = photograph(), with_holes(256, 256)
    y, x = distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled, nearest, wanted = (to_display(light)[~known] for light in (inpaint(image, known), image[y, x], image))
    assert psnr_db(filled, wanted) > psnr_db(nearest, wanted) + 1


def test_a_wide_gap_is_crossed_without_leaving_the_range_of_its_borders() -> None:
    image = np.zeros((90, 300, 1), np.float32)
    image[:, 280:] = 1
    known = np.zeros((90, 300), bool)
    known[:, :20] = known[:, 280:] = True
    middle = to_display(inpaint(image, known))[45, :, 0]
    assert np.all(np.diff(middle) >= -0.01 * LEVEL)
    assert middle[150] == pytest.approx(0.5, abs=0.02)


def test_one_known_pixel_fills_the_whole_picture() -> None:
    known = np.zeros((33, 70), bool)
    known[30, 2] = True
    image = noise(33, 70, 3)
    out = inpaint(image, known)
    assert np.abs(out - image[30, 2]).max() < 1e-5


def test_what_unknown_pixels_hold_does_not_matter() -> None:
    image, known = noise(64, 64, 1), with_holes(64, 64)
    rubbish = np.where(known[..., None], image, np.nan)
    assert np.array_equal(inpaint(image, known), inpaint(rubbish, known))


def test_nothing_to_fill_changes_nothing_and_nothing_known_is_an_error() -> None:
    image = noise(9, 8, 3)
    assert np.array_equal(inpaint(image, np.ones((9, 8), bool)), image)
    with pytest.raises(ValueError, match="no pixel"):
        inpaint(image, np.zeros((9, 8), bool))
