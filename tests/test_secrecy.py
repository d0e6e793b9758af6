"""What universal lenses and their sources give away."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from magiclens.analysis.secrecy import secrecy, secrecy_word, shown_in_sheet, tile_likeness
from magiclens.contract.artifacts import Assignment, Lens, Scene, View
from magiclens.images.art import ART
from magiclens.images.colour import to_display, to_linear
from magiclens.matching.key_size import key_size_bits


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_without_limits_the_maps_are_counted_exactly(rng: np.random.Generator) -> None:
    """Five facets, eight places within everyone's reach, two signs each: 8! / 3! * 2^5 ways."""
    places, usable = np.tile(np.arange(8), (5, 1)), np.ones((5, 8, 2), bool)
    assert key_size_bits(places, usable, rng) == pytest.approx(math.log2(8 * 7 * 6 * 5 * 4 * 2**5))


def test_within_limits_the_estimate_is_near_the_count(rng: np.random.Generator) -> None:
    """A ring: each of 8 facets reaches its own place and the next; only two permutations stay within that."""
    places = np.stack([np.arange(8), (np.arange(8) + 1) % 8], axis=1)
    bits = key_size_bits(places, np.ones((8, 2, 1), bool), rng, rounds=4000)
    assert bits == pytest.approx(1.0, abs=0.15)


def test_no_way_is_minus_infinity(rng: np.random.Generator) -> None:
    assert key_size_bits(np.zeros((2, 1), int), np.ones((2, 1, 1), bool), rng) == -math.inf


def lens_and_view(offset: float) -> tuple[Lens, Assignment, View]:
    """A lens that shows its own target, moved aside, as it lies below."""
    lens, n = Lens(size_mm=20, source_size_mm=20, facets=4), 4
    target = ART["panda"](320)
    view = View("v", np.roll(target, round(offset * 16), axis=1), target, np.array([0.0, 0.0, 340.0]))
    maps = np.broadcast_to(np.array([1.0, 0.0, 1.0]), (n, n, 3)).copy()
    offsets = np.broadcast_to(np.array([offset, 0.0]), (n, n, 2)).copy()
    return lens, Assignment(np.zeros((n, n), np.int64), offsets, maps, np.zeros((n, n))), view


def test_patches_that_show_their_tiles_are_fully_readable() -> None:
    lens, assignment, view = lens_and_view(1.0)
    inner = tile_likeness(lens, assignment, view)[:, :3]
    assert inner.min() > 0.97
    assert tile_likeness(lens, assignment, view, shift=1).mean() < 0.9


def test_mirrored_patches_are_read_mirrored() -> None:
    lens, assignment, view = lens_and_view(0.0)
    maps = assignment.maps * (-1, 1, 1)
    flipped = view.target.reshape(320, 4, 80, 1)[:, :, ::-1].reshape(320, 320, 1)
    other = View("v", flipped, view.target, view.eye_mm)
    mirrored = Assignment(assignment.choice, assignment.offsets_mm, maps, assignment.errors)
    assert tile_likeness(lens, mirrored, other).min() > 0.97
    assert tile_likeness(lens, assignment, other).min() < 0.9


def test_a_source_unlike_its_target_has_a_low_score(rng: np.random.Generator) -> None:
    lens, assignment, view = lens_and_view(1.0)
    noise = View("v", rng.random((320, 320, 1)).astype(np.float32), view.target, view.eye_mm)
    near, far = (secrecy(Scene(lens, (v,)), assignment).metrics for v in (view, noise))
    assert near["stealth_ssim"] > far["stealth_ssim"] + 0.2
    assert near["tile_leakage"] > 0.95
    assert far["tile_leakage"] == pytest.approx(far["tile_leakage_by_chance"], abs=0.1)


def scattered(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The picture's tiles of 8 x 8 pixels in another order."""
    n = len(picture) // 8
    tiles = picture.reshape(n, 8, n, 8, 1).swapaxes(1, 2).reshape(n * n, 8, 8, 1)[rng.permutation(n * n)]
    return tiles.reshape(n, n, 8, 8, 1).swapaxes(1, 2).reshape(picture.shape)


def test_how_much_shows_without_the_lens_has_a_word(rng: np.random.Generator) -> None:
    lens, panda = Lens(size_mm=50, source_size_mm=50, facets=16), ART["panda"](320)
    noise = scattered(panda, rng)
    sheets = {"plain": panda, "hidden": noise, "guessable": 0.3 * panda + 0.7 * noise}
    words = {name: secrecy_word(shown_in_sheet(sheet, panda, lens)) for name, sheet in sheets.items()}
    assert words == {name: name for name in sheets}


def test_a_negative_shows_the_picture_too_and_a_pale_copy() -> None:
    lens, panda = Lens(size_mm=50, source_size_mm=50, facets=16), ART["panda"](320)
    assert secrecy_word(shown_in_sheet(1 - panda, panda, lens)) == "plain"
    assert secrecy_word(shown_in_sheet(0.7 + 0.3 * panda, panda, lens)) == "plain"


@pytest.mark.parametrize("name", ["panda", "bat"])
def test_the_measure_is_ssim_tile_by_tile_in_place(name: str, rng: np.random.Generator) -> None:
    """As scikit-image has it, with a window nearly as wide as a tile; pictures here need no eye that adapts."""
    lens, picture = Lens(size_mm=50, source_size_mm=50, facets=16), ART[name](256)
    sheet = (0.6 * picture + 0.4 * scattered(picture, rng)).astype(np.float32)
    usual = [0.5 + 0.25 * (shown - shown.mean()) / shown.std() for shown in (to_display(sheet), to_display(picture))]
    seen, wanted = (np.clip(shown, 0, 1)[..., 0].astype(float) for shown in usual)
    _, found = structural_similarity(
        seen, wanted, data_range=1.0, win_size=15, full=True, use_sample_covariance=False
    )  # fmt: skip
    lit = [to_linear(shown[..., None].astype(np.float32)) for shown in (seen, wanted)]
    assert shown_in_sheet(*lit, lens) == pytest.approx(found[8::16, 8::16].mean(), abs=0.04)


def test_tiles_in_another_order_hide_a_picture_whose_tiles_are_uneven(rng: np.random.Generator) -> None:
    lens, waves = Lens(size_mm=50, source_size_mm=50, facets=16), rng.random((40, 40, 1)).repeat(8, 0).repeat(8, 1)
    assert secrecy_word(shown_in_sheet(scattered(waves, rng), waves, lens)) == "hidden"
    assert secrecy_word(shown_in_sheet(waves, waves, lens)) == "plain"


def test_only_the_sheet_below_the_lens_is_compared(rng: np.random.Generator) -> None:
    lens, panda = Lens(size_mm=50, source_size_mm=100, facets=16), ART["panda"](320)
    sheet = np.ones((640, 640, 1), np.float32)
    sheet[160:480, 160:480] = panda
    assert shown_in_sheet(sheet, panda, lens) > 0.95
    noise = rng.random(sheet.shape).astype(np.float32)
    assert shown_in_sheet(noise, panda, lens) < 0.05
