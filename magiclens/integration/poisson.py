"""Two-level screened Poisson integration, both levels solved by cosine transforms (4.5)."""

from __future__ import annotations

from functools import partial
from typing import ClassVar, Literal

from pydantic import Field

from magiclens.contract.artifacts import Assignment, HeightField, Scene
from magiclens.contract.stages import Integrator, Progress, silent
from magiclens.contract.units import Length


class Poisson(Integrator):
    """Facets become smooth lenslets (one small Poisson problem each), then are raised or lowered until edges meet."""

    type: ClassVar[str] = "poisson"
    version: ClassVar[str] = "4"

    placement: Literal["light", "steps"] = Field(
        "light", description="facets' heights: least light lost at walls, or least squared steps (4.5)"
    )
    step_weight: float = Field(0.002, ge=0, description="`light` only: cost of a squared step per edge, per mm^2")
    screening: float = Field(
        1e-3, ge=0, description="pulls facets back to the reference plane; raised when the relief would be exceeded"
    )
    step_limit: Length | None = Field(
        None, description="no step between facets exceeds this; taken from the micro-facets at the border"
    )
    rounds: int = Field(30, ge=1, description="rounds of orientation and integration, at most")
    refinement: int = Field(
        16, ge=0, description="steps of free-form refinement, per blur of the sources; 0 leaves facets smooth lenslets"
    )
    tolerance: float = Field(1e-5, gt=0, description="stop once no height moves by more than this, mm")

    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        """Iterate orientation and integration to convergence."""
        from magiclens.integration.two_level import integrate

        return integrate(self, scene, assignment, progress)

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        """Move the facets' vertices so that they show their tiles better; borders stay where steps are limited."""
        from magiclens.integration.placement import place_for_light
        from magiclens.integration.refine import refine

        if self.refinement == 0:
            return built
        if self.step_limit is not None:
            return refine(scene, built, self.refinement, progress, locked=True)
        place = partial(place_for_light, scene, even=self.step_weight) if self.placement == "light" else None
        return refine(scene, built, self.refinement, progress, place)
