"""The paper's annealer: random swaps that make neighbouring normals more alike (4.4)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, Scene
from magiclens.contract.stages import Annealer, Progress, silent


class Metropolis(Annealer):
    """Swaps facets' candidates while the smoothness of normals, eqs (3) and (4), stays below a threshold."""

    type: ClassVar[str] = "metropolis"

    alpha: float = Field(0.125, ge=0, description="weight of differences between neighbouring normals")
    beta: float = Field(0.375, ge=0, description="weight of normals turning sideways")
    gamma: float = Field(0.5, ge=0, description="weight of the normals' curl, which no surface can have")
    acceptance: float = Field(
        0.002, ge=0, description="candidates worse than a facet's best by more than this error are not used"
    )
    swaps: int = Field(25, ge=1, description="swaps tried per facet and round")
    rounds: int = Field(200, ge=1, description="rounds, at most")
    patience: int = Field(10, ge=1, description="stop after this many rounds in a row without progress")
    least_gain: float = Field(0.0, ge=0, lt=1, description="stop once a round gains less than this part of the start")

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        """Never worse than the start. Energies in ``metrics`` are means over facets, in 0..1."""
        from magiclens.annealing.swapping import anneal

        return anneal(self, scene, candidates, rng, progress)
