"""The paper's annealer: random swaps that make neighbouring normals more alike (4.4)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, Scene
from magiclens.contract.stages import Annealer, Progress, silent


class Metropolis(Annealer):
    """Swaps facets' candidates while the smoothness of normals, eqs (3) and (4), stays below a threshold."""

    type: ClassVar[str] = "metropolis"

    alpha: float = Field(0.125, ge=0, le=1e6, description="weight of differences between neighbouring normals")
    beta: float = Field(0.375, ge=0, le=1e6, description="weight of normals turning sideways")
    gamma: float = Field(0.5, ge=0, le=1e6, description="weight of the normals' curl, which no surface can have")
    acceptance: float = Field(
        0.002, ge=0, le=1e6, description="candidates worse than a facet's best by more than this error are not used"
    )
    swaps: int = Field(25, ge=1, le=10_000, description="swaps tried per facet and round")
    rounds: int = Field(200, ge=1, le=100_000, description="rounds, at most")
    patience: int = Field(10, ge=1, le=100_000, description="stop after this many rounds in a row without progress")
    least_gain: float = Field(0.0, ge=0, lt=1, description="stop once a round gains less than this part of the start")

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        """Swap in rounds, each kept only if it lowers the energy of the whole lens; never worse than the start.

        Args:
            scene: the lens and its views.
            candidates: what to choose from; K per facet.
            rng: draws the facets that are tried and their new candidates.
            progress: is told the share of the rounds that are done.

        Returns:
            One candidate per facet. The energies in ``metrics`` are means over facets, in 0..1.
        """
        from magiclens.annealing.metropolis_kernels import Weights, lens_energy, try_swaps
        from magiclens.geometry.facets import central_slopes

        n = scene.lens.facets
        normals = _unit_normals(central_slopes(scene, candidates.offsets_mm))
        best = candidates.errors.min(axis=-1, keepdims=True)
        good = candidates.errors <= best + self.acceptance
        # each facet's usable candidates, best first: rematching leaves them out of order
        order, usable = np.argsort(candidates.errors, axis=-1, kind="stable"), good.sum(axis=-1)
        normals = np.take_along_axis(normals, order[..., None], axis=2)
        weights = Weights(self.alpha, self.beta, self.gamma)
        choice = np.zeros((n, n), np.int64)
        initial = lowest = lens_energy(normals, choice, weights)
        successes = idle = 0
        for done in range(self.rounds):
            # T of (4.4); its t counts only the rounds that made the lens smoother
            threshold = initial * np.exp(0.01 * successes) / (100 * n**2)
            trial, tries = choice.copy(), self.swaps * n**2
            try_swaps(normals, trial, usable, weights, threshold, rng.integers(0, n, (tries, 2)), rng.random(tries))
            energy = lens_energy(normals, trial, weights)
            progress((done + 1) / self.rounds)
            if energy >= lowest:
                idle += 1
                if idle == self.patience:
                    break
                continue
            gain, choice, lowest, successes, idle = lowest - energy, trial, energy, successes + 1, 0
            if gain < self.least_gain * initial:
                break
        metrics = {"energy_before": initial / n**2, "energy_after": lowest / n**2, "annealing_rounds": done + 1.0}
        return Assignment.pick(candidates, np.take_along_axis(order, choice[..., None], axis=2)[..., 0], metrics)


def _unit_normals(slopes: FloatArray) -> FloatArray:
    """(..., 2): x and y of the unit normals of surfaces with slopes dz/dx and dz/dy (..., 2)."""
    normals: FloatArray = -slopes / np.sqrt(1 + (slopes**2).sum(axis=-1, keepdims=True))
    return normals
