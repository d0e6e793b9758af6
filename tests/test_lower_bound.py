"""The bound below annealing's energy: never above what a lens costs, and near it where that is known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from magiclens.annealing.heat_bath import HeatBath
from magiclens.annealing.lower_bound import lower_bound
from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.optics.walls import DOWN, LEFT, RIGHT, UP, Edges, EnergyTerms, settle_levels, wall_energies
from scenes import blank_scene, choices, small_lens

RELIEF = 5.0
TERMS = EnergyTerms(0.5, 1.0, 0.002, 1e-5)


def random_edges(rng: np.random.Generator, rows: int, columns: int, labels: int, drift: float = 0.05) -> Edges:
    """Profiles of some tenths of a millimetre, nearly even along an edge."""
    shape = rows, columns, labels, 4
    drifts = np.repeat(rng.uniform(0, drift, (*shape, 1)), 4, axis=-1)
    profiles = rng.normal(0, 0.3, (*shape, 1)) + rng.normal(0, 0.05, (*shape, 4))
    return Edges(profiles.astype(np.float32), drifts.astype(np.float32))


def chosen(edges: Edges, choice: IntArray) -> Edges:
    i, j = np.indices(choice.shape)
    return Edges(*(np.ascontiguousarray(a[i, j, choice]) for a in edges))


def least_energy(errors: FloatArray, edges: Edges, terms: EnergyTerms) -> float:
    """Of all choices of candidates, each at heights that are settled."""
    n, _, labels = errors.shape
    energies = []
    for labelling in product(range(labels), repeat=n * n):
        choice, heights = np.array(labelling).reshape(n, n), np.zeros((n, n))
        taken = chosen(edges, choice)
        for turn in range(10):
            settle_levels(heights, taken, terms, RELIEF, turn)
        image = np.take_along_axis(errors, choice[..., None], axis=-1).sum()
        energies.append(image + wall_energies(heights, taken, terms).sum())
    return float(min(energies))


@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    loss=st.sampled_from([0.0, 0.1, 0.5]),
    even=st.sampled_from([0.0, 1e-4, 0.002, 0.5]),
    screening=st.sampled_from([0.0, 1e-5, 0.01]),
    rounds=st.sampled_from([1, 5, 40]),
)
def test_no_choice_costs_less(seed: int, loss: float, even: float, screening: float, rounds: int) -> None:
    rng, terms = np.random.default_rng(seed), EnergyTerms(loss, 1.0, even, screening)
    errors, edges = rng.uniform(0, 1e-3, (3, 3, 2)), random_edges(rng, 3, 3, 2)
    errors[1, 1, 1] = np.inf
    assert lower_bound(errors, edges, terms, RELIEF, rounds) <= least_energy(errors, edges, terms) * (1 + 1e-5) + 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_row_of_facets_is_solved_exactly(seed: int) -> None:
    """Its steps can all be the best ones."""
    rng, (count, labels) = np.random.default_rng(seed), (5, 3)
    errors, terms = rng.uniform(0, 1e-3, (1, count, labels)), TERMS._replace(screening=0.0)
    edges = random_edges(rng, 1, count, labels)

    def least_step(j: int, k: int, m: int) -> float:
        own, other = edges.profiles[0, j, k, RIGHT], edges.profiles[0, j + 1, m, LEFT]
        rise, fall = edges.drifts[0, j, k, RIGHT, 0], edges.drifts[0, j + 1, m, LEFT, 0]

        def cost(step: float) -> float:
            steps = step + own - other
            lost = rise * np.maximum(steps, 0) + fall * np.maximum(-steps, 0)
            return float((terms.loss / terms.pitch * lost + terms.even * steps**2).mean())

        return float(minimize_scalar(cost, bounds=(-3, 3), method="bounded", options={"xatol": 1e-6}).fun)

    pairs = np.array([[[least_step(j, k, m) for m in range(labels)] for k in range(labels)] for j in range(count - 1)])
    best = min(
        sum(errors[0, j, k] for j, k in enumerate(row)) + sum(pairs[j, row[j], row[j + 1]] for j in range(count - 1))
        for row in product(range(labels), repeat=count)
    )
    assert lower_bound(errors, edges, terms, RELIEF, 1) == pytest.approx(best, rel=1e-4)
    # the same as a column: what was right is down, what was left is up
    column = Edges(*(np.ascontiguousarray(a[..., [UP, LEFT, DOWN, RIGHT], :].swapaxes(0, 1)) for a in edges))
    assert lower_bound(errors.swapaxes(0, 1), column, terms, RELIEF, 1) == pytest.approx(best, rel=1e-4)


@pytest.mark.parametrize("screening", [0.0, 1e-4, 0.01])
def test_without_a_choice_the_bound_is_nearly_what_settled_heights_cost(screening: float) -> None:
    """The energy is convex then. Drifts are small: light that is lost at corners does not count for the bound."""
    rng, terms = np.random.default_rng(1), TERMS._replace(screening=screening)
    errors, edges = np.zeros((8, 8, 1)), random_edges(rng, 8, 8, 1, 0.002)
    heights, taken = np.zeros((8, 8)), chosen(edges, np.zeros((8, 8), int))
    for turn in range(50):
        settle_levels(heights, taken, terms, RELIEF, turn)
    energy = wall_energies(heights, taken, terms).sum()
    assert 0.99 * energy < lower_bound(errors, edges, terms, RELIEF, 1500) <= energy
    assert lower_bound(errors, edges, terms, RELIEF, 1) < 0.5 * energy


def test_one_facet_costs_its_least_error() -> None:
    errors, edges = np.array([[[0.3, 0.2, np.inf]]]), random_edges(np.random.default_rng(0), 1, 1, 3)
    assert lower_bound(errors, edges, TERMS, RELIEF, 3) == np.float32(0.2)


def test_the_bound_never_falls() -> None:
    rng = np.random.default_rng(0)
    errors, edges = rng.uniform(0, 1e-3, (6, 6, 5)), random_edges(rng, 6, 6, 5)
    bounds = [lower_bound(errors, edges, TERMS, RELIEF, rounds) for rounds in (1, 2, 3, 5, 10, 20, 40)]
    assert bounds == sorted(bounds)
    assert bounds[-1] > bounds[0] > errors.min(axis=-1).sum()


def test_annealing_reports_how_far_its_energy_is_above_the_bound() -> None:
    rng, shape = np.random.default_rng(3), (8, 8, 6)
    found = choices(rng.uniform(-4, 4, (*shape, 2)), rng.uniform(-0.8, 0.8, (*shape, 3)), rng.uniform(0, 0.02, shape))
    annealers = HeatBath(sweeps=20), HeatBath(sweeps=20, bound=30)
    plain, bounded = (a.anneal(blank_scene(small_lens(8)), found, np.random.default_rng(0)) for a in annealers)
    np.testing.assert_array_equal(plain.choice, bounded.choice)
    assert not {"energy_bound", "energy_above_bound_percent"} & set(plain.metrics)
    metrics = bounded.metrics
    assert 0 < metrics["energy_bound"] <= metrics["energy_after"]
    above = 100 * (metrics["energy_after"] / metrics["energy_bound"] - 1)
    assert metrics["energy_above_bound_percent"] == pytest.approx(above)
