"""Simulated annealing of what really costs: image error plus light lost at the walls between facets."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, Scene
from magiclens.contract.stages import Annealer, Progress, silent


class HeatBath(Annealer):
    """Heat-bath annealing of candidates and heights together; both terms of its energy are squared display values."""

    type: ClassVar[str] = "heat-bath"

    sweeps: int = Field(60, ge=1, description="sweeps over all facets while cooling")
    temperature: float = Field(0.003, ge=0, description="at the start, in mean squared display values")
    loss_weight: float = Field(1.0, ge=0, description="weight of light lost at walls; 1 is what it costs the picture")
    step_weight: float = Field(0.002, ge=0, description="cost of a squared step per facet edge, per mm^2")
    screening: float = Field(1e-5, ge=0, description="cost of a facet's squared height, per mm^2")

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        """Never worse than every facet's best candidate. Energies in ``metrics`` are per facet."""
        from magiclens.annealing.cooling import anneal

        return anneal(self, scene, candidates, rng, progress)
