"""The vector layer and the built-in pictures."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, pairwise

import numpy as np
import pytest
from scipy.ndimage import label

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import ART, art, resize, to_display
from magiclens.images.raster import coverage, rasterize
from magiclens.images.vector import (
    Layer,
    blob,
    brush,
    centred,
    curve,
    ellipse,
    fill,
    flat,
    linear_gradient,
    mirrored,
    placed,
    polygon,
    radial_gradient,
    rectangle,
    turned,
)

WORMS = [f"worm-{k}" for k in range(8)]
PAINTINGS = ["flower", "truck", "foliage"]
SILHOUETTES = sorted(set(ART) - set(WORMS) - set(PAINTINGS))


# Vector layer


def test_coverage_is_the_share_of_each_pixels_area() -> None:
    assert coverage([rectangle(0.5, 0.25, 2.0, 1.5)], (2, 3)).tolist() == [[0.375, 0.75, 0], [0.25, 0.5, 0]]
    assert coverage([polygon("0,0 1,0 0,1")], (1, 1)).tolist() == [[0.5]]


def test_what_lies_beyond_the_picture_is_cut_off() -> None:
    assert coverage([rectangle(-5, -5, 1.5, 9)], (2, 3)).tolist() == [[1, 0.5, 0]] * 2
    assert (rasterize([Layer((rectangle(120, 0, 140, 9),), flat(0.0))], 8) == 1).all()


@pytest.mark.parametrize("size_px", [9, 64, 333])
def test_a_drawn_ellipse_has_its_true_area_at_any_size(size_px: int) -> None:
    ink = 1 - rasterize([Layer((ellipse(48, 51, 30, 20, 25),), flat(0.0))], size_px).mean()
    assert ink == pytest.approx(np.pi * 30 * 20 / 1e4, rel=1e-3)


def test_an_outline_that_runs_the_other_way_cuts_a_hole_if_asked() -> None:
    ring = [rectangle(1, 1, 4, 4), rectangle(2, 2, 3, 3)[::-1]]
    assert coverage(ring, (5, 5), holes=True)[2].tolist() == [0, 1, 0, 1, 0]
    assert coverage(ring, (5, 5))[2].tolist() == [0, 1, 1, 1, 0]


def test_overlapping_outlines_unite_whichever_way_they_run() -> None:
    square, again = rectangle(1, 1, 3, 3), rectangle(2, 1, 4, 3)[::-1]
    assert coverage([square, again], (5, 5)).sum() == pytest.approx(6)


def test_row_zero_is_the_top() -> None:
    picture = rasterize([Layer((rectangle(0, 0, 100, 25),), flat(0.0))], 4)
    assert picture[:, 0, 0].tolist() == [0, 1, 1, 1]


def test_later_layers_lie_on_top_and_mix_light_by_their_opacity() -> None:
    whole = rectangle(0, 0, 100, 100)
    picture = rasterize([Layer((whole,), flat(0.0)), Layer((whole,), flat(0.8), opacity=0.5)], 3)
    assert picture == pytest.approx(0.4)


def test_curves_pass_through_their_points_and_turn_only_at_corners() -> None:
    outline = blob("10,10! 90,10 90,90! 10,90")
    nearest = [np.hypot(*(outline - p).T).argmin() for p in ((10, 10), (90, 10), (90, 90), (10, 90))]
    assert np.hypot(*(outline[nearest] - ((10, 10), (90, 10), (90, 90), (10, 90))).T) == pytest.approx(0, abs=1e-9)
    edges = np.diff(outline, axis=0, append=outline[:1])
    edges = edges[np.hypot(*edges.T) > 1e-9]
    a, b = edges, np.roll(edges, -1, axis=0)
    bends = np.abs(np.degrees(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(1))))
    assert (bends > 20).sum() == 2


def test_a_stroke_has_its_width_and_round_ends() -> None:
    outline = brush(curve("20,50 80,50"), 10)
    assert outline.min(0) == pytest.approx([15, 45], abs=0.1)
    assert outline.max(0) == pytest.approx([85, 55], abs=0.1)
    area = coverage([outline], (100, 100)).sum()
    assert area == pytest.approx(600 + np.pi * 25, rel=0.01)


def test_turning_is_clockwise_as_seen_and_mirroring_swaps_left_and_right() -> None:
    assert turned(polygon("50,10"), 90)[0] == pytest.approx([90, 50])
    assert placed(polygon("0,-1"), 50, 50, 40, 90)[0] == pytest.approx([90, 50])
    assert mirrored(polygon("10,20"))[0] == pytest.approx([90, 20])


def test_fitted_layers_are_centred_and_as_long_as_asked() -> None:
    (layer,) = centred([Layer((rectangle(0, 0, 10, 5),), flat(0.0))], side=80)
    assert layer.outlines[0].min(0) == pytest.approx([10, 30])
    assert layer.outlines[0].max(0) == pytest.approx([90, 70])


def test_gradients_run_between_their_display_colours() -> None:
    x, y = np.array([[0.0, 50, 100]]), np.zeros((1, 3))
    across = linear_gradient((0, 0), (100, 0), "#000000", "#ffffff")
    assert to_display(across(x, y))[0, :, 1] == pytest.approx([0, 0.5, 1], abs=1e-6)
    outward = radial_gradient((0, 0), 50, "#ff0000", "#0000ff")
    assert outward(x, y)[0, 0].tolist() == [1, 0, 0]
    assert outward(x, y)[0, 2].tolist() == [0, 0, 1]


def test_a_display_colour_fills_in_linear_light() -> None:
    picture = rasterize([fill("#bc8040", rectangle(0, 0, 100, 100))], 2, paper=(1.0, 1.0, 1.0))
    assert to_display(picture)[0, 0] * 255 == pytest.approx([0xBC, 0x80, 0x40], abs=0.01)


# Pictures


@pytest.fixture(scope="module")
def pictures() -> dict[str, FloatArray]:
    return {name: art(name, 96) for name in ART}


@pytest.fixture(scope="module")
def paintings() -> dict[str, FloatArray]:
    """Display values."""
    return {name: to_display(art(name, 192)) for name in PAINTINGS}


def test_every_promised_picture_is_there() -> None:
    animals = {"panda", "bat", "penguin", "whale", "cat", "rabbit", "owl", "elephant"}
    things = {"heart", "star", "question_mark", "exclamation", "tree", "house", "sun", "moon", "fish", "key", "anchor"}
    answers = {"lincoln", "washington", "eiffel_tower", "dinosaur", "apple", "lightbulb"}
    assert set(ART) == animals | things | answers | set(WORMS) | set(PAINTINGS)


@pytest.mark.parametrize("name", list(ART))
def test_a_picture_has_the_size_asked_for_and_lies_in_the_range(name: str, pictures: dict[str, FloatArray]) -> None:
    picture = pictures[name]
    assert picture.shape == (96, 96, 3 if name in PAINTINGS else 1)
    assert picture.dtype == np.float32
    assert picture.min() >= 0
    assert picture.max() <= 1


@pytest.mark.parametrize("name", SILHOUETTES)
def test_a_silhouette_is_centred_and_fills_most_of_the_square(name: str, pictures: dict[str, FloatArray]) -> None:
    rows, columns = np.nonzero(pictures[name][..., 0] < 0.5)
    spans = np.array([[rows.min(), rows.max() + 1], [columns.min(), columns.max() + 1]])
    assert 0.75 * 96 < np.diff(spans).max() < 0.85 * 96
    assert spans.mean(1) == pytest.approx(48, abs=2)


@pytest.mark.parametrize("name", SILHOUETTES + WORMS)
def test_a_silhouette_is_bold_black_on_white(name: str, pictures: dict[str, FloatArray]) -> None:
    picture = pictures[name]
    assert 0.08 < (picture < 0.02).mean() < 0.5
    assert ((picture > 0.02) & (picture < 0.98)).mean() < 0.2
    assert (picture[[0, -1]] == 1).all()
    assert (picture[:, [0, -1]] == 1).all()


@pytest.mark.parametrize("name", ["panda", "bat", "star", "heart", "sun", "eiffel_tower"])
def test_an_outline_that_ought_to_be_symmetric_is(name: str, pictures: dict[str, FloatArray]) -> None:
    assert np.abs(pictures[name] - pictures[name][:, ::-1]).mean() < (0.03 if name == "heart" else 1e-4)


def test_pictures_stand_upright(pictures: dict[str, FloatArray]) -> None:
    def dark(name: str, rows: slice) -> float:
        return float((pictures[name][rows] < 0.5).sum())

    assert dark("heart", slice(0, 48)) > 2 * dark("heart", slice(60, 96)) > 0
    assert dark("tree", slice(0, 48)) > dark("tree", slice(60, 96)) > 0
    assert dark("exclamation", slice(0, 48)) > dark("exclamation", slice(60, 96)) > 0
    assert dark("eiffel_tower", slice(60, 96)) > dark("eiffel_tower", slice(0, 48)) > 0


@pytest.mark.parametrize(
    ("name", "spaces"),
    [("lincoln", 1), ("washington", 3), ("eiffel_tower", 12), ("dinosaur", 1), ("apple", 1), ("lightbulb", 1)],
)
def test_white_within_the_black_stays_open_when_small(name: str, spaces: int, pictures: dict[str, FloatArray]) -> None:
    _, regions = label(pictures[name][..., 0] > 0.5)
    assert regions - 1 >= spaces


def test_the_tower_stands_on_two_legs_under_an_arch(pictures: dict[str, FloatArray]) -> None:
    rows = pictures["eiffel_tower"][76:84, :, 0]
    assert (rows[:, 42:54] == 1).all()
    assert (rows[:, :42].min(1) < 0.5).all()


def test_washingtons_bow_and_the_dinosaurs_jaws_are_on_the_right(pictures: dict[str, FloatArray]) -> None:
    def middle(name: str, rows: slice) -> float:
        return float(np.nonzero(pictures[name][rows, :, 0] < 0.5)[1].mean())

    assert middle("washington", slice(40, 60)) > 52
    assert middle("dinosaur", slice(0, 30)) > 60


def test_no_two_silhouettes_look_alike(pictures: dict[str, FloatArray]) -> None:
    for a, b in combinations(SILHOUETTES, 2):
        assert np.abs(pictures[a] - pictures[b]).mean() > 0.05, (a, b)


@pytest.mark.parametrize("name", ["panda", "worm-3", "truck"])
def test_a_picture_is_the_same_at_any_size(name: str, pictures: dict[str, FloatArray]) -> None:
    assert np.abs(resize(art(name, 288), (96, 96)) - pictures[name]).mean() < 0.004


@pytest.mark.parametrize("name", ["whale", "flower"])
def test_drawing_again_gives_the_same_pixels(name: str, pictures: dict[str, FloatArray]) -> None:
    assert np.array_equal(art(name, 96), pictures[name])


def test_the_worm_moves_evenly_and_its_last_frame_leads_back_to_the_first(pictures: dict[str, FloatArray]) -> None:
    frames = [pictures[name] for name in WORMS]
    steps = [float(np.abs(b - a).mean()) for a, b in pairwise([*frames, frames[0]])]
    assert min(steps) > 0.01
    assert steps[-1] < 1.2 * max(steps[:-1])


def test_paintings_are_rich_in_fine_detail(paintings: dict[str, FloatArray]) -> None:
    for name, display in paintings.items():
        assert np.abs(np.diff(display, axis=0)).mean() > 0.015, name
        assert len(np.unique(np.round(display * 15).reshape(-1, 3), axis=0)) > 400, name


def test_foliage_holds_every_hue_and_both_light_and_dark(paintings: dict[str, FloatArray]) -> None:
    display = paintings["foliage"].reshape(-1, 3)
    high, low = display.max(1), display.min(1)
    vivid = display[high - low > 0.3]
    angle = np.arctan2(np.sqrt(3) * (vivid[:, 1] - vivid[:, 2]), 2 * vivid[:, 0] - vivid[:, 1] - vivid[:, 2])
    counts = np.histogram(angle, bins=12, range=(-np.pi, np.pi))[0]
    assert counts.min() > 0.02 * counts.sum()
    assert (high < 0.25).mean() > 0.02
    assert (low > 0.75).mean() > 0.01


@pytest.mark.parametrize(
    ("typed", "meant"), [("pnada", "panda"), ("question-mark", "question_mark"), ("worm", "worm-")]
)
def test_an_unknown_name_is_answered_with_the_nearest(typed: str, meant: str) -> None:
    with pytest.raises(InputError, match=f"did you mean '{meant}"):
        art(typed, 16)


def test_a_name_like_no_other_is_answered_with_all_choices() -> None:
    with pytest.raises(InputError, match=r"choose one of anchor, apple, bat, .*whale"):
        art("xyzzy", 16)


def test_every_entry_is_a_function_of_the_size(pictures: dict[str, FloatArray]) -> None:
    drawing: Callable[[int], FloatArray] = ART["panda"]
    assert np.array_equal(drawing(96), pictures["panda"])
