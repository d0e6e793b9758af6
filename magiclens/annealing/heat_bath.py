"""Simulated annealing of what really costs: image error plus light lost at the walls between facets."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, IntArray, Scene
from magiclens.contract.stages import Annealer, Progress, silent
from magiclens.kernels.resuming import resumable

_COLD_SWEEPS = 10
"""Number of sweeps at temperature 0 after the cooling, which bring every facet to its nearest minimum."""


class HeatBath(Annealer):
    """Heat-bath annealing of candidates and heights together; both terms of its energy are squared display values."""

    type: ClassVar[str] = "heat-bath"

    sweeps: int = Field(60, ge=1, le=10_000, description="sweeps over all facets while cooling")
    temperature: float = Field(0.003, ge=0, le=100, description="at the start, in mean squared display values")
    loss_weight: float = Field(
        1.0, ge=0, le=1e6, description="weight of light lost at walls; 1 is what it costs the picture"
    )
    step_weight: float = Field(0.002, ge=0, le=1e6, description="cost of a squared step per facet edge, per mm^2")
    screening: float = Field(1e-5, ge=0, le=1e6, description="cost of a facet's squared height, per mm^2")

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        """Choose by heat-bath sweeps under a quadratically falling temperature; never worse than every facet's best.

        Args:
            scene: the lens and its views.
            candidates: what to choose from; K per facet.
            rng: draws one number in [0, 1) per facet and sweep.
            progress: is told the share of the sweeps that are done.

        Returns:
            One candidate per facet. The energies in ``metrics`` are per facet, in mean squared display values.
        """
        from magiclens.geometry.facets import cost_of_lost_light, edge_models
        from magiclens.optics.walls import EnergyTerms, total_energy

        n = scene.lens.facets
        edges = edge_models(scene, candidates.offsets_mm, candidates.maps)
        errors = candidates.errors.astype(np.float64)
        loss = self.loss_weight * cost_of_lost_light(scene)
        terms = EnergyTerms(loss, scene.lens.pitch_mm, self.step_weight, self.screening)
        relief = scene.lens.relief_mm

        # The start, which the result must not be worse than: every facet's best candidate, at its best height.
        first, first_levels = errors.argmin(axis=-1), np.zeros((n, n))
        only_first = np.where(np.arange(errors.shape[-1]) == first[..., None], errors, np.inf)
        for _ in resumable(range(self.sweeps), first, first_levels):
            if not _sweep(first, first_levels, only_first, edges, terms, relief, 0.0, np.zeros((n, n))):
                break
        before = float(total_energy(first, first_levels, errors, edges, terms).sum())

        choice, levels = first.copy(), first_levels.copy()
        falling = self.temperature * (1 - np.arange(self.sweeps) / self.sweeps) ** 2
        temperatures = np.concatenate([falling, np.zeros(_COLD_SWEEPS)])
        dice = enumerate(rng.random((n, n)) for _ in temperatures)
        settled = False
        for done, temperature in resumable(list(enumerate(temperatures)), choice, levels):
            if not settled:
                chance = next(drawn for number, drawn in dice if number == done)
                moved = _sweep(choice, levels, errors, edges, terms, relief, temperature, chance)
                settled = temperature == 0 and not moved
            progress((done + 1) / len(temperatures))
        for _ in dice:  # drawn even if not used, for whoever draws next
            pass
        after = float(total_energy(choice, levels, errors, edges, terms).sum())
        if after > before:
            choice, levels, after = first, first_levels, before
        image, lost_light, even = total_energy(choice, levels, errors, edges, terms) / n**2
        metrics = {
            "energy_before": before / n**2,
            "energy_after": after / n**2,
            "energy_image": float(image),
            "energy_lost_light": float(lost_light),
            "energy_even": float(even),
        }
        return Assignment.pick(candidates, choice, metrics)


def _sweep(choice: IntArray, levels: FloatArray, *others: Any) -> bool:
    """One ``heat_bath_sweep``; whether it changed anything. At temperature 0, no later sweep does once one does not."""
    from magiclens.optics.walls import heat_bath_sweep

    before = choice.copy()
    return heat_bath_sweep(choice, levels, *others) > 0 or not np.array_equal(choice, before)
