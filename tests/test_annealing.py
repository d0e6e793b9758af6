"""Annealers: never worse than their start, reproducible, and fond of neighbours that fit."""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np
import pytest

from magiclens.annealing.heat_bath import HeatBath
from magiclens.annealing.metropolis import Metropolis
from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, IntArray, Scene
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Annealer
from magiclens.integration.poisson import Poisson
from magiclens.optics.medium import slab_of
from magiclens.optics.refraction import facet_normal
from scenes import ABOVE, THICK, assigned, blank_scene, choices, small_lens

N = 8
IDENTITY = (1.0, 0.0, 1.0)
annealers = pytest.mark.parametrize(
    "annealer",
    [HeatBath(sweeps=10), HeatBath(sweeps=10, settle=3, bound=5), Metropolis(acceptance=0.02)],
    ids=["heat-bath", "heat-bath, settled and bounded", "metropolis"],
)


def annealed(annealer: Annealer, scene: Scene, candidates: Candidates, seed: int = 0) -> Assignment:
    return annealer.anneal(scene, candidates, np.random.default_rng(seed))


def many_candidates(seed: int = 0, labels: int = 12) -> Candidates:
    """Random offsets and maps; errors rise with the label, and some facets have fewer candidates."""
    rng, shape = np.random.default_rng(seed), (N, N, labels)
    errors = np.sort(rng.uniform(0, 0.02, shape), axis=-1)
    errors[rng.random((N, N)) < 0.3, labels // 2 :] = np.inf
    return choices(rng.uniform(-4, 4, (*shape, 2)), rng.uniform(-0.8, 0.8, (*shape, 3)) * (1, 0.3, 1), errors)


@pytest.fixture
def scene() -> Scene:
    return blank_scene(small_lens(N))


@pytest.fixture
def threads() -> Iterator[None]:
    """Restores the number of threads."""
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


@annealers
@pytest.mark.parametrize("seed", range(3))
def test_annealing_is_never_worse_than_its_start(annealer: Annealer, scene: Scene, seed: int) -> None:
    found = annealed(annealer, scene, many_candidates(seed), seed)
    assert found.metrics["energy_after"] < found.metrics["energy_before"]


@annealers
def test_a_single_candidate_leaves_no_choice(annealer: Annealer, scene: Scene) -> None:
    found = annealed(annealer, scene, many_candidates(labels=2))
    single = choices(found.offsets_mm[:, :, None], found.maps[:, :, None], found.errors[:, :, None])
    again = annealed(annealer, scene, single)
    assert (again.choice == 0).all()
    assert again.metrics["energy_after"] == pytest.approx(again.metrics["energy_before"], rel=0.02)


@annealers
def test_candidates_that_are_missing_are_never_chosen(annealer: Annealer, scene: Scene) -> None:
    candidates = many_candidates()
    found = annealed(annealer, scene, candidates)
    assert np.isfinite(found.errors).all()
    i, j = np.indices(found.choice.shape)
    np.testing.assert_array_equal(found.offsets_mm, candidates.offsets_mm[i, j, found.choice])
    np.testing.assert_array_equal(found.maps, candidates.maps[i, j, found.choice])


@annealers
def test_equal_seeds_give_equal_choices(annealer: Annealer, scene: Scene) -> None:
    first, again, other = (annealed(annealer, scene, many_candidates(), seed).choice for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@annealers
@pytest.mark.usefixtures("threads")
def test_the_number_of_threads_makes_no_difference(annealer: Annealer, scene: Scene) -> None:
    found = []
    for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(count)
        found.append(annealed(annealer, scene, many_candidates()))
    np.testing.assert_array_equal(found[0].choice, found[1].choice)
    assert found[0].metrics == found[1].metrics


# heat bath


@pytest.mark.parametrize("options", [{}, {"loss_weight": 0.3}, {"step_weight": 0.5, "screening": 0.01}])
def test_the_parts_of_the_energy_add_up(scene: Scene, options: dict[str, float]) -> None:
    found = annealed(HeatBath(sweeps=10, **options), scene, many_candidates())
    parts = [found.metrics[f"energy_{part}"] for part in ("image", "lost_light", "even")]
    assert sum(parts) == pytest.approx(found.metrics["energy_after"], rel=1e-9)
    assert parts[0] == pytest.approx(found.errors.mean(), rel=1e-5)


def test_the_parts_add_up_when_the_start_could_not_be_improved() -> None:
    rng, shape = np.random.default_rng(0), (N, N, 6)
    offsets = rng.uniform(-4, 4, (*shape, 2))
    offsets[:, :, 0] = 0
    candidates = choices(offsets, np.broadcast_to(IDENTITY, (*shape, 3)), np.zeros(shape))
    found = annealed(HeatBath(temperature=1.0, sweeps=1, step_weight=0.02), blank_scene(small_lens(N)), candidates)
    assert (found.choice == 0).all()
    assert found.metrics["energy_after"] == found.metrics["energy_before"]
    parts = [found.metrics[f"energy_{part}"] for part in ("image", "lost_light", "even")]
    assert sum(parts) == pytest.approx(found.metrics["energy_after"], rel=1e-9)


def test_without_temperature_chance_plays_no_part(scene: Scene) -> None:
    cold = HeatBath(temperature=0.0, sweeps=10)
    first, other = (annealed(cold, scene, many_candidates(), seed) for seed in (1, 2))
    np.testing.assert_array_equal(first.choice, other.choice)
    assert first.metrics["energy_after"] < first.metrics["energy_before"]


def test_cooling_finds_less_than_a_cold_descent(scene: Scene) -> None:
    def mean_energy(temperature: float) -> float:
        annealer = HeatBath(sweeps=40, temperature=temperature)
        return float(np.mean([annealed(annealer, scene, many_candidates(k)).metrics["energy_after"] for k in range(4)]))

    assert mean_energy(0.003) < mean_energy(0.0)


def test_squares_that_settle_between_sweeps_bring_heights_that_facets_do_not_find_one_by_one(scene: Scene) -> None:
    """There is no choice; facets that all look outward have heights of a bowl."""
    outward = choices(
        scene.lens.facet_centres_mm()[:, :, None] / 5, np.ones((N, N, 1, 3)) * IDENTITY, np.zeros((N, N, 1))
    )
    alone, settled = (annealed(HeatBath(settle=settle), scene, outward).metrics["energy_after"] for settle in (0, 2))
    assert settled < 0.5 * alone


def rough_or_flat(error: float) -> Candidates:
    """A perfect candidate that bends light any which way, and a flat one with an error."""
    offsets = np.zeros((N, N, 2, 2))
    offsets[:, :, 0] = np.random.default_rng(0).uniform(-4, 4, (N, N, 2))
    errors = np.zeros((N, N, 2))
    errors[..., 1] = error
    return choices(offsets, np.broadcast_to(IDENTITY, (N, N, 2, 3)), errors)


def test_a_candidate_without_error_loses_against_one_that_fits(scene: Scene) -> None:
    found = annealed(HeatBath(), scene, rough_or_flat(0.0003))
    assert found.choice.mean() > 0.8
    assert found.metrics["energy_after"] < 0.2 * found.metrics["energy_before"]


def test_a_mixture_is_better_than_either_kind_of_candidate_alone(scene: Scene) -> None:
    """Facets whose perfect candidate happens to fit keep it; the others take the flat one."""
    found = annealed(HeatBath(sweeps=30), scene, rough_or_flat(0.003))
    assert 0.1 < found.choice.mean() < 0.9
    assert found.metrics["energy_after"] < min(0.003, found.metrics["energy_before"])


def test_without_weight_light_lost_at_walls_counts_for_nothing(scene: Scene) -> None:
    found = annealed(HeatBath(sweeps=5, loss_weight=0.0, step_weight=0.0), scene, rough_or_flat(0.003))
    assert (found.choice == 0).all()


def test_a_candidate_whose_error_costs_more_than_its_steps_is_not_taken(scene: Scene) -> None:
    found = annealed(HeatBath(sweeps=30), scene, rough_or_flat(0.5))
    assert (found.choice == 0).all()


def test_a_lenslet_too_tall_for_the_relief_is_not_chosen() -> None:
    lens = small_lens(4, relief_mm=0.3)
    offsets, errors = np.zeros((4, 4, 2, 2)), np.zeros((4, 4, 2))
    offsets[:, :, 0] = (9.0, 0.0)
    errors[..., 1] = 0.01
    candidates = choices(offsets, np.broadcast_to(IDENTITY, (4, 4, 2, 3)), errors)
    scene = blank_scene(lens)
    with pytest.raises(StageError, match="relief"):
        Poisson().integrate(scene, assigned(candidates.offsets_mm[:, :, 0], IDENTITY))
    assert (annealed(HeatBath(sweeps=10), scene, candidates).choice == 1).all()


# metropolis


def direct_energy(scene: Scene, candidates: Candidates, choice: IntArray, weights: tuple[float, ...]) -> float:
    """Mean over facets of eq. (3), from whole arrays: g are the normals' x and y, the border repeats itself."""
    n, lens = len(choice), scene.lens
    g = np.zeros((n, n, 2))
    for i, j in np.ndindex(n, n):
        centre = lens.facet_centres_mm()[i, j]
        source = centre + candidates.offsets_mm[i, j, choice[i, j]]
        g[i, j] = facet_normal(ABOVE, (*centre, THICK), tuple(source), slab_of(lens))[:2]
    wide: FloatArray = np.pad(g, ((1, 1), (1, 1), (0, 0)), mode="edge")
    right, left, up, down = wide[1:-1, 2:] - g, wide[1:-1, :-2] - g, wide[:-2, 1:-1] - g, wide[2:, 1:-1] - g
    differences = sum((d**2).sum(axis=-1) for d in (right, left, up, down)) / 16
    sideways = (right[..., 1] + left[..., 1] + up[..., 0] + down[..., 0]) / 8
    curl = ((right - left)[..., 1] - (up - down)[..., 0]) / 4
    alpha, beta, gamma = weights
    return float((alpha * differences + beta * sideways**2 + gamma * curl**2).mean())


@pytest.mark.parametrize("weights", [(0.125, 0.375, 0.5), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_the_papers_energy_is_that_of_a_direct_sum(scene: Scene, weights: tuple[float, float, float]) -> None:
    candidates = many_candidates()
    options = Metropolis(alpha=weights[0], beta=weights[1], gamma=weights[2], acceptance=0.02)
    found = annealed(options, scene, candidates)
    start = np.zeros((N, N), np.int64)
    assert found.metrics["energy_before"] == pytest.approx(direct_energy(scene, candidates, start, weights), rel=1e-6)
    assert found.metrics["energy_after"] == pytest.approx(
        direct_energy(scene, candidates, np.array(found.choice), weights), rel=1e-6
    )


def test_a_lens_of_equal_normals_has_no_energy() -> None:
    """Far below the eye, one offset everywhere means one normal everywhere."""
    scene = blank_scene(small_lens(4), (0.0, 0.0, 1e9))
    same = choices(np.full((4, 4, 1, 2), 2.0), np.ones((4, 4, 1, 3)), np.zeros((4, 4, 1)))
    found = annealed(Metropolis(), scene, same)
    assert found.metrics["energy_before"] == pytest.approx(0.0, abs=1e-12)


def test_annealing_stops_when_patience_or_rounds_end(scene: Scene) -> None:
    single = choices(
        *(a[:, :, :1] for a in (many_candidates().offsets_mm, many_candidates().maps, np.zeros((N, N, 1))))
    )
    assert annealed(Metropolis(patience=4), scene, single).metrics["annealing_rounds"] == 4
    assert annealed(Metropolis(rounds=3, patience=4), scene, single).metrics["annealing_rounds"] == 3


def test_a_round_that_gains_too_little_is_the_last(scene: Scene) -> None:
    candidates = many_candidates()
    eager, content = (annealed(Metropolis(least_gain=g, acceptance=0.02), scene, candidates) for g in (0.0, 0.9))
    assert content.metrics["annealing_rounds"] <= 2 < eager.metrics["annealing_rounds"]
    assert eager.metrics["energy_after"] < content.metrics["energy_after"]


@pytest.mark.parametrize("acceptance", [0.0, 0.002, 0.01])
def test_candidates_much_worse_than_the_best_are_not_used(scene: Scene, acceptance: float) -> None:
    candidates = many_candidates()
    found = annealed(Metropolis(acceptance=acceptance), scene, candidates)
    assert (found.errors <= candidates.errors[..., 0] + acceptance + 1e-9).all()
    assert (found.choice > 0).any() == (acceptance > 0)


def test_a_best_candidate_spoilt_by_rematching_is_not_used() -> None:
    """Rematching corrects errors but keeps the order, so that the first candidate may no longer be the best."""
    fits, shape = many_candidates(labels=6), (N, N, 6)
    errors = np.broadcast_to([0.5, 0.001, 0.0015, 0.4, 0.4, 0.4], shape)
    found = annealed(
        Metropolis(acceptance=0.002), blank_scene(small_lens(N)), choices(fits.offsets_mm, fits.maps, errors)
    )
    assert found.errors.max() <= 0.003
