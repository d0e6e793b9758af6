"""Dart throwing: every facet draws a place of its own, within reach, off what is reserved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magiclens.contract.artifacts import BoolArray, Candidates, IntArray, Lens, Scene, View
from magiclens.contract.errors import InputError
from magiclens.matching.dart_throwing import DartThrowing, throw_darts
from magiclens.matching.dart_throwing_kernels import Labels, draw_again

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
