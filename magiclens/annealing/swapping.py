"""The numerics of the ``metropolis`` annealer (4.4, eqs 3 and 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, Scene
from magiclens.contract.stages import Progress
from magiclens.geometry.facets import central_slopes

if TYPE_CHECKING:
    from magiclens.annealing.metropolis import Metropolis


def anneal(
    options: Metropolis, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress
) -> Assignment:
    """See ``Metropolis.anneal``."""
    n = scene.lens.facets
    normals = unit_normals(central_slopes(scene, candidates.offsets_mm))
    best = candidates.errors.min(axis=-1, keepdims=True)
    good = candidates.errors <= best + options.acceptance
    # each facet's usable candidates, best first: rematching leaves them out of order
    order, usable = np.argsort(candidates.errors, axis=-1, kind="stable"), good.sum(axis=-1)
    normals = np.take_along_axis(normals, order[..., None], axis=2)
    weights = np.array([options.alpha, options.beta, options.gamma])
    choice = np.zeros((n, n), np.int64)
    initial = lowest = lens_energy(normals, choice, weights)
    t = idle = 0
    for done in range(options.rounds):
        threshold = initial * np.exp(0.01 * t) / (100 * n**2)
        trial, tries = choice.copy(), options.swaps * n**2
        _swap(normals, trial, usable, weights, threshold, rng.integers(0, n, (tries, 2)), rng.random(tries))
        energy = lens_energy(normals, trial, weights)
        progress((done + 1) / options.rounds)
        if energy >= lowest:
            idle += 1
            if idle == options.patience:
                break
            continue
        gain, choice, lowest, t, idle = lowest - energy, trial, energy, t + 1, 0
        if gain < options.least_gain * initial:
            break
    metrics = {"energy_before": initial / n**2, "energy_after": lowest / n**2, "annealing_rounds": done + 1.0}
    return Assignment.pick(candidates, np.take_along_axis(order, choice[..., None], axis=2)[..., 0], metrics)


def unit_normals(slopes: FloatArray) -> FloatArray:
    """(..., 2): x and y of the unit normals of surfaces with slopes dz/dx and dz/dy (..., 2)."""
    normals: FloatArray = -slopes / np.sqrt(1 + (slopes**2).sum(axis=-1, keepdims=True))
    return normals


@njit(cache=True)
def facet_energy(normals, choice, i, j, k, weights):
    """Energy in 0..1 of facet (i, j) with candidate k, eq. (3); outside the lens, a facet's own normal goes on.

    The last term of E1 is printed d_y in the paper; by symmetry, and by its explanation, d_x is meant. Each term is
    divided by its largest possible value.
    """
    n = len(choice)
    gx, gy = normals[i, j, k, 0], normals[i, j, k, 1]
    total = across = 0.0
    turn = np.zeros(4)
    for e in range(4):
        r = i - 1 if e == 2 else (i + 1 if e == 3 else i)
        c = j + 1 if e == 0 else (j - 1 if e == 1 else j)
        if 0 <= r < n and 0 <= c < n:
            dx = normals[r, c, choice[r, c], 0] - gx
            dy = normals[r, c, choice[r, c], 1] - gy
            total += dx * dx + dy * dy
            turn[e] = dy if e < 2 else dx
            across += turn[e]
    curl = (turn[0] - turn[1]) - (turn[2] - turn[3])
    return weights[0] * total / 16.0 + weights[1] * (across / 8.0) ** 2 + weights[2] * (curl / 4.0) ** 2


@njit(cache=True)
def lens_energy(normals, choice, weights):
    """Sum of all facets' energies."""
    total = 0.0
    for i in range(len(choice)):
        for j in range(len(choice)):
            total += facet_energy(normals, choice, i, j, choice[i, j], weights)
    return total


@njit(cache=True)
def _swap(normals, choice, usable, weights, threshold, places, dice):
    """Try swaps in place at ``places``, each to one of the usable candidates, if its energy rises less than allowed."""
    for s in range(len(places)):
        i, j = places[s]
        k = int(dice[s] * usable[i, j])
        change = facet_energy(normals, choice, i, j, k, weights) - facet_energy(
            normals, choice, i, j, choice[i, j], weights
        )
        if change < threshold:
            choice[i, j] = k

