"""Simulated annealing of what really costs: image error plus light lost at the walls between facets."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, IntArray, Scene
from magiclens.contract.stages import Annealer, Progress, silent
from magiclens.kernels.resuming import resumable

if TYPE_CHECKING:
    from magiclens.optics.walls import Edges, EnergyTerms

_COLD_SWEEPS = 10
"""Number of sweeps at temperature 0 after the cooling, which bring every facet to its nearest minimum."""
_LEVEL_SWEEPS = 60
"""Number of sweeps that move facets one by one to where the start costs least. To move squares of them, too, as the
integrator does, or between the sweeps that cool, gave 1 % less energy, but pictures 0.1 dB worse after refinement."""


class HeatBath(Annealer):
    """Heat-bath annealing of candidates and heights together; both terms of its energy are squared display values."""

    type: ClassVar[str] = "heat-bath"
    version: ClassVar[str] = "2"

    sweeps: int = Field(60, ge=1, le=100_000, description="sweeps over all facets while cooling")
    temperature: float = Field(0.003, ge=0, le=100, description="at the start, in mean squared display values")
    loss_weight: float = Field(
        1.0, ge=0, le=1e6, description="weight of light lost at walls; 1 is what it costs the picture"
    )
    step_weight: float = Field(0.002, ge=0, le=1e6, description="cost of a squared step per facet edge, per mm^2")
    screening: float = Field(1e-5, ge=0, le=1e6, description="cost of a facet's squared height, per mm^2")
    settle: int = Field(
        0, ge=0, le=10_000, description="after every so many sweeps, squares of facets rise or fall together; 0: never"
    )
    bound: int = Field(
        0, ge=0, le=10_000, description="rounds that look for a lower bound of the energy, which is reported; 0: none"
    )

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        """Choose by heat-bath sweeps under a quadratically falling temperature; never worse than every facet's best.

        Args:
            scene: the lens and its views.
            candidates: what to choose from; K per facet.
            rng: draws a number per sweep, with which the generator begins that draws for single facets.
            progress: is told the share of the sweeps that are done.

        Returns:
            One candidate per facet. The energies in ``metrics`` are per facet, in mean squared display values.
        """
        from magiclens.annealing.heat_bath_kernels import heat_bath_sweep
        from magiclens.optics.walls import levels_sweep, settle_levels

        n, lens = scene.lens.facets, _Lens.of(scene, candidates, self)
        # The start, which the result must not be worse than: every facet's best candidate, at its best height.
        first, first_levels = lens.errors.argmin(axis=-1), np.zeros((n, n))
        edges = lens.edges(first)
        for _ in resumable(range(_LEVEL_SWEEPS), first_levels):
            levels_sweep(first_levels, edges, lens.terms, scene.lens.relief_mm, (1, 0, 0))
        before = lens.energies(first, first_levels)

        choice, levels = first.copy(), first_levels.copy()
        seeds = rng.integers(2**63, size=self.sweeps + _COLD_SWEEPS)
        for done in resumable(range(len(seeds)), choice, levels):
            chance, temperature = np.random.default_rng(seeds[done]), max(1 - done / self.sweeps, 0.0) ** 2
            heat_bath_sweep(
                choice, levels, lens.table, lens.terms, self.temperature * temperature, chance.random((n, n))
            )
            if self.settle and (done + 1) % self.settle == 0:
                turn = done // self.settle
                settle_levels(levels, lens.edges(choice), lens.terms, scene.lens.relief_mm, turn)
            progress((done + 1) / len(seeds))
        after = lens.energies(choice, levels)
        if after.sum() > before.sum():
            choice, after = first, before
        image, lost_light, even = (float(part) / n**2 for part in after)
        metrics = {
            "energy_before": float(before.sum()) / n**2,
            "energy_after": float(after.sum()) / n**2,
            "energy_image": image,
            "energy_lost_light": lost_light,
            "energy_even": even,
        }
        if self.bound:
            metrics |= self._bound(scene, candidates, lens, metrics["energy_after"])
        return Assignment.pick(candidates, choice, metrics)

    def _bound(self, scene: Scene, candidates: Candidates, lens: _Lens, energy: float) -> dict[str, float]:
        """Metrics of how little the energy could be at best."""
        from magiclens.annealing.lower_bound import lower_bound
        from magiclens.geometry.facets import edge_models

        edges = edge_models(scene, candidates.offsets_mm, candidates.maps)
        bound = lower_bound(lens.errors, edges, lens.terms, scene.lens.relief_mm, self.bound) / scene.lens.facets**2
        above = {"energy_above_bound_percent": 100 * (energy / bound - 1)} if bound > 0 else {}
        return {"energy_bound": bound, **above}


class _Lens(NamedTuple):
    """What annealing needs to know of a lens.

    Args:
        errors: (N, N, K) image errors; inf where there is no candidate.
        table: errors and edges of candidates, see ``heat_bath_kernels.tabulate``.
        terms: what steps cost.
    """

    errors: FloatArray
    table: FloatArray
    terms: EnergyTerms

    @classmethod
    def of(cls, scene: Scene, candidates: Candidates, options: HeatBath) -> _Lens:
        from magiclens.annealing.heat_bath_kernels import tabulate
        from magiclens.geometry.facets import cost_of_lost_light, edge_models
        from magiclens.optics.walls import EnergyTerms

        loss, errors = options.loss_weight * cost_of_lost_light(scene), candidates.errors.astype(np.float64)
        edges = edge_models(scene, candidates.offsets_mm, candidates.maps)
        terms = EnergyTerms(loss, scene.lens.pitch_mm, options.step_weight, options.screening)
        return cls(errors, tabulate(errors, edges, scene.lens.relief_mm), terms)

    def edges(self, choice: IntArray) -> Edges:
        """The ``Edges`` (N, N, 4, Q) of the candidates that facets take."""
        from magiclens.annealing.heat_bath_kernels import chosen_edges

        return chosen_edges(choice, self.table)

    def energies(self, choice: IntArray, levels: FloatArray) -> FloatArray:
        """(3,) image error, light lost at walls and the even part, each summed over the lens."""
        from magiclens.optics.walls import wall_energies

        image = np.take_along_axis(self.errors, choice[..., None], axis=-1).sum()
        return np.array([image, *wall_energies(levels, self.edges(choice), self.terms).sum(axis=(0, 1))])
