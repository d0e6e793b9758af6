"""Dart throwing: every facet draws a place of its own, within reach, off what is reserved."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magiclens.contract.artifacts import BoolArray, Candidates, IntArray, Lens, Scene, View
from magiclens.contract.errors import InputError
from magiclens.matching.dart_throwing import DartThrowing, Reach, SubRegions, throw_darts
from magiclens.matching.dart_throwing_kernels import Labels, draw_again
from magiclens.matching.grain import flat_scale, seen_grain
from magiclens.optics.eyes import land
from magiclens.optics.medium import slab_of
from test_matching import flat_enough

LENS = Lens(size_mm=40, source_size_mm=40, facets=6, microfacets=24, thickness_mm=40)
PAPER = np.ones((120, 120, 1), np.float32)


def scene(lens: Lens = LENS, reserved: BoolArray | None = None) -> Scene:
    return Scene(lens, (View("v", PAPER, PAPER, np.array([0.0, 0.0, 440.0])),), reserved)


def thrown(seed: int, options: dict[str, object] | None = None, reserved: BoolArray | None = None) -> Candidates:
    darts = DartThrowing.model_validate({"reach": "20%", **(options or {})})
    return darts.match(scene(reserved=reserved), np.random.default_rng(seed))


def squares(found: Candidates) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corners (F, 2) of what facets look at, mm, with what their micro-facets add."""
    centres = (LENS.facet_centres_mm() + found.offsets_mm[:, :, 0]).reshape(-1, 2).astype(float)
    half = abs(found.maps[:, :, 0, [0, 2]]).reshape(-1, 2) * (LENS.pitch_mm - LENS.pitch_mm / 24) / 2
    half = half + 1.07 * LENS.pitch_mm / 24 / 2
    return centres - half, centres + half


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("options", [{}, {"subdivisions": 3, "guard": "2%"}, {"sweeps": 0}])
def test_no_two_facets_look_at_the_same_place(seed: int, options: dict[str, object]) -> None:
    low, high = squares(thrown(seed, options))
    apart = (low[:, None] >= high[None] - 1e-6) | (high[:, None] <= low[None] + 1e-6)
    assert (apart.any(axis=-1) | np.eye(len(low), dtype=bool)).all()
    assert low.min() >= -20
    assert high.max() <= 20


def test_what_is_within_reach_is_asked_of_each_facet_where_it_is() -> None:
    """By one ray through the centre and each corner of a facet, for an eye far aside."""
    lens = replace(LENS, facets=4, max_slope_deg=45.0, relief_mm=15.0)
    eye = np.array([30.0, -50.0, 440.0])
    seen = Scene(lens, (View("v", PAPER, PAPER, eye),))
    options = DartThrowing(reach="35%")
    reach = Reach.of(options, seen, SubRegions.of(lens, options.subdivisions))
    inside = reach.regions < reach.regions.max()
    for f, centre in enumerate(lens.facet_centres_mm().reshape(-1, 2)):
        for k, s in itertools.product(range(len(reach.offsets)), range(4)):
            (xx, yy), offset = reach.maps[s], reach.offsets[k] * (1, -1)
            flat = flat_enough(lens, tuple(eye), centre, offset, xx, yy)
            assert reach.usable[f, k, s] == (flat and inside[f, k])
    assert 0.05 < reach.usable.mean() < 0.9


def test_every_mirror_sign_of_a_place_is_offered() -> None:
    found = thrown(0)
    assert found.errors.shape == (6, 6, 4)
    assert (found.offsets_mm == found.offsets_mm[:, :, :1]).all()
    assert len({tuple(np.sign(m)) for m in found.maps[2, 2][:, [0, 2]].tolist()}) == 4
    assert set(np.unique(found.errors)) <= {0.0, np.inf}


def test_draws_differ_by_seed_only() -> None:
    np.testing.assert_array_equal(thrown(1).offsets_mm, thrown(1).offsets_mm)
    assert (thrown(1).offsets_mm != thrown(2).offsets_mm).any()


def test_drawing_again_gives_every_facet_its_turn_in_every_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    """What facets have drawn first is forbidden them; the first sweep has turns of one facet alone."""

    def forbidding(chosen: IntArray, owner: IntArray, labels: Labels, turns: IntArray, *more: Any) -> None:
        usable, (i, j) = labels.usable.copy(), np.indices(chosen.shape)
        usable[i, j, chosen] = False
        count = chosen.size
        turns = np.array([np.zeros(count, int), np.arange(count)])
        draw_again(chosen, owner, labels._replace(usable=usable), turns, *more)
        assert usable[i, j, chosen].all()
        drawn = labels.regions[i, j, chosen].ravel()
        assert len(set(drawn.tolist())) == count
        assert (owner[drawn] == np.arange(count)).all()

    monkeypatch.setattr("magiclens.matching.dart_throwing_kernels.draw_again", forbidding)
    thrown(0)


def test_reach_bounds_how_far_facets_look() -> None:
    assert abs(thrown(0, {"reach": "12%"}).offsets_mm).max() <= 0.12 * 40 + 1e-6


def test_reserved_places_are_left_alone() -> None:
    reserved = np.zeros((120, 120), bool)
    reserved[50:70] = True
    low, high = squares(thrown(0, reserved=reserved))
    assert ((low[:, 1] >= 10 / 3 - 1e-6) | (high[:, 1] <= -10 / 3 + 1e-6)).all()


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_all_that_is_not_reserved_can_be_drawn_beside_the_lens_too(turn: int) -> None:
    """The source has 8 x 8 places, the lens 6 x 6 facets, and as many places are free, up and to the right."""
    lens, side = replace(LENS, source_size_mm=160 / 3), 20
    reserved = np.ones((8 * side, 8 * side), bool)
    reserved[side : 7 * side, 2 * side :] = False
    view = View("v", PAPER, PAPER, np.array([0.0, 0.0, 440.0]), 90.0 * turn)
    darts = DartThrowing(subdivisions=1, reach="25%", guard="0%")
    found = darts.match(Scene(lens, (view,), reserved), np.random.default_rng(turn))
    places = (lens.facet_centres_mm() + found.offsets_mm[:, :, 0]).reshape(-1, 2)
    for _ in range(turn):  # counter-clockwise, with the lens
        places = np.stack([-places[:, 1], places[:, 0]], axis=-1)
    columns, rows = np.rint(places / lens.pitch_mm + 3.5).astype(int).T
    assert {(7 - row, column) for row, column in zip(rows, columns, strict=True)} == {
        (row, column) for row in range(1, 7) for column in range(2, 8)
    }


def test_a_place_is_reserved_if_any_of_its_pixels_is_in_any_view() -> None:
    """One pixel in the corner of a place; a view turned by 180 degrees needs the place across, too."""
    lens, side = replace(LENS, source_size_mm=160 / 3), 20
    views = tuple(View("v", PAPER, PAPER, np.array([0.0, 0.0, 440.0]), angle) for angle in (0.0, 180.0))
    darts, drawn = DartThrowing(subdivisions=1, reach="25%", guard="0%"), set()
    for k, corner in enumerate([(2 * side, side), (3 * side - 1, 2 * side - 1)] * 8):
        reserved = np.zeros((8 * side, 8 * side), bool)
        reserved[corner] = True
        found = darts.match(Scene(lens, views, reserved), np.random.default_rng(k))
        places = (lens.facet_centres_mm() + found.offsets_mm[:, :, 0]).reshape(-1, 2)
        drawn |= {tuple(place) for place in np.rint(places * (1, -1) / lens.pitch_mm + 3.5).astype(int).tolist()}
    assert not drawn & {(1, 2), (6, 5)}
    assert drawn >= {(1, 1), (1, 3), (2, 2), (0, 2), (6, 4), (6, 6), (5, 5), (7, 5)}


@pytest.mark.parametrize(("subdivisions", "reach", "farthest"), [(1, 1.0, 1.0), (2, 0.75, 0.75), (3, 0.7, 2 / 3)])
def test_what_lies_just_within_reach_is_drawn_too(subdivisions: int, reach: float, farthest: float) -> None:
    """In facets: centres of their thirds lie 0, 1/3, 2/3 and so on away."""
    options = {"reach": f"{reach * LENS.pitch_mm:.9f}mm", "subdivisions": subdivisions, "guard": "0%"}
    found = [thrown(seed, options).offsets_mm / LENS.pitch_mm for seed in range(3)]
    for axis in range(2):
        assert np.max([o[..., axis] for o in found]) == pytest.approx(farthest, abs=1e-5)
        assert np.min([o[..., axis] for o in found]) == pytest.approx(-farthest, abs=1e-5)


@pytest.mark.parametrize("guard", [0.0, 0.1])
def test_a_facet_sees_its_place_up_to_the_guard(guard: float) -> None:
    """The middles of its outer micro-facets move by the map, and each shows a patch, a little larger than itself."""
    found, cell = thrown(0, {"guard": f"{guard:.0%}"}), LENS.pitch_mm / LENS.microfacets
    flat = 1 + LENS.thickness_mm / LENS.ior / 400
    seen = abs(found.maps[..., [0, 2]]) * (LENS.pitch_mm - cell) + flat * cell
    np.testing.assert_allclose(seen, LENS.pitch_mm / 2 * (1 - 2 * guard), rtol=1e-6)
    assert (found.maps[..., 1] == 0).all()


def test_a_place_that_is_too_small_for_a_micro_facet_is_an_input_error() -> None:
    with pytest.raises(InputError, match=r"a micro-facet sees 0.296 mm of the source, more than .* of 0.833 mm"):
        thrown(0, {"subdivisions": 8, "guard": "33%"})


@pytest.mark.parametrize("lens", [LENS, replace(LENS, gap_mm=20.0)])
def test_a_flat_facet_shows_as_much_as_refraction_says(lens: Lens) -> None:
    eye, up = (0.0, 0.0, 440.0), (0.0, 0.0, 1.0)
    x, _, _ = land(eye, (0.1, 0.0, 40.0), up, slab_of(lens))
    assert flat_scale(scene(lens)) == pytest.approx(x / 0.1, rel=1e-5)
    assert seen_grain(scene(lens)) > flat_scale(scene(lens)) * lens.pitch_mm / lens.microfacets
    assert seen_grain(scene(replace(lens, microfacets=12))) == pytest.approx(2 * seen_grain(scene(lens)))


def test_too_much_reserved_is_an_input_error() -> None:
    reserved = np.ones((120, 120), bool)
    reserved[:40] = False
    with pytest.raises(InputError, match="gets no sub-region of its own"):
        thrown(0, reserved=reserved)


def test_eyes_that_differ_are_an_input_error() -> None:
    views = tuple(View("v", PAPER, PAPER, np.array([x, 0.0, 440.0])) for x in (0.0, 50.0))
    with pytest.raises(InputError, match="share one eye"):
        DartThrowing().match(Scene(LENS, views), np.random.default_rng(0))


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_a_full_draw_is_found_whenever_there_is_one(seed: int) -> None:
    """A hidden permutation is allowed, and little else: greedy throwing gets stuck, augmenting paths do not."""
    rng = np.random.default_rng(seed)
    n = 20
    hidden = rng.permutation(n)
    places = np.tile(np.arange(n), (n, 1))
    allowed = rng.random((n, n)) < 0.08
    allowed[np.arange(n), hidden] = True
    drawn = throw_darts(places, allowed, n, rng)
    assert sorted(drawn.tolist()) == list(range(n))
    assert allowed[np.arange(n), drawn].all()
