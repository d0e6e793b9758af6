"""The paper's integrator: one over-constrained linear system for all heights (4.5, after Papas et al. 2011)."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from magiclens.contract.artifacts import Assignment, HeightField, Scene
from magiclens.contract.stages import Integrator, Progress, silent


class LeastSquares(Integrator):
    """Slopes of every micro-facet and coincidence of every pair of facing vertices, weighed against each other."""

    type: ClassVar[str] = "least-squares"

    continuity: float = Field(
        1.0, gt=0, description="weight of edges meeting, against slopes; large: a continuous surface, as milling wants"
    )
    screening: float = Field(1e-7, ge=0, description="pulls every vertex back to the reference plane")
    rounds: int = Field(12, ge=1, description="rounds of orientation and integration, at most")
    tolerance: float = Field(1e-4, gt=0, description="stop once no height moves by more than this, mm")

    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        """Iterate orientation and integration to convergence."""
        from magiclens.integration.whole_grid import integrate

        return integrate(self, scene, assignment, progress)
