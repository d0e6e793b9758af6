"""Two-level screened Poisson integration: facets become smooth lenslets, then whole facets find their levels (4.5)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene
from magiclens.contract.stages import Integrator, Progress, silent
from magiclens.contract.units import Length
from magiclens.integration.laplacian import cosines, divergence
from magiclens.integration.limits import limit_steps
from magiclens.integration.surface_metrics import surface_metrics
from magiclens.processes.linear import LinearProcess


class Poisson(Integrator):
    """Facets become smooth lenslets (one small Poisson problem each), then are raised or lowered until edges meet."""

    type: ClassVar[str] = "poisson"
    version: ClassVar[str] = "6"

    placement: Literal["light", "steps"] = Field(
        "light", description="facets' heights: least light lost at walls, or least squared steps (4.5)"
    )
    step_weight: float = Field(
        0.002, ge=0, le=1e6, description="`light` only: cost of a squared step per edge, per mm^2"
    )
    screening: float = Field(
        1e-3,
        ge=0,
        le=1e6,
        description="pulls facets back to the reference plane; raised when the relief would be exceeded",
    )
    step_limit: Length | None = Field(
        None, ge=0, le=500, description="no step between facets exceeds this; taken from the micro-facets at the border"
    )
    rounds: int = Field(30, ge=1, le=1000, description="rounds of orientation and integration, at most")
    refinement: int = Field(
        12,
        ge=0,
        le=1000,
        description="steps of free-form refinement, per blur of the sources; 0 leaves facets smooth lenslets",
    )
    tolerance: float = Field(1e-5, gt=0, le=1, description="stop once no height moves by more than this, mm")
    process: LinearProcess | None = Field(
        None, description="what the machine evens out: the whole top is refined by what it shows as made"
    )

    @property
    def goes_on(self) -> bool:
        """See ``Integrator``: facets that the process joins are one surface, which keeps no choice of patches."""
        return self.process is not None and self.refinement > 0

    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        """Iterate orientation and integration to convergence."""
        from magiclens.integration.iterate import check_relief, iterate
        from magiclens.integration.levels import levels_of_least_lost_light, levels_of_least_steps, within_relief

        n, k = scene.lens.facets, scene.lens.microfacets + 1
        relief = scene.lens.relief_mm
        levels: FloatArray = np.zeros((n, n))
        screening = self.screening

        def solve(rows: FloatArray, columns: FloatArray, _: FloatArray, done: int) -> FloatArray:
            nonlocal levels, screening
            shapes = lenslets(rows, columns).reshape(n, n, k, k)
            check_relief(shapes, relief)  # a lenslet that is taller than the relief fits at no level
            if self.placement == "steps" or done == 0:
                levels, screening = levels_of_least_steps(shapes, screening, relief)
            # once: later rounds would oscillate at the kinks of its energy
            if self.placement == "light" and done == 0:
                levels = levels_of_least_lost_light(scene, shapes, levels, self.step_weight)
            return shapes + within_relief(shapes, levels, relief)[:, :, None, None]

        built = iterate(scene, assignment, solve, self.rounds, self.tolerance, progress)
        if self.step_limit is None:
            return built
        limited = replace(built, heights_mm=limit_steps(built.heights_mm, self.step_limit))
        return replace(limited, metrics={**built.metrics, **surface_metrics(limited)})

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        """Move the vertices so that facets show their tiles better, as designed or, through the process, as made.

        Borders stay where steps are limited.
        """
        from magiclens.integration.levels import levels_of_least_lost_light
        from magiclens.integration.refinement import refine

        if self.refinement == 0:
            return built
        if self.process and built.eye_mm is None:
            from magiclens.integration.through_process import can_be_held, refine_through

            if can_be_held(scene.lens, self.process):
                return refine_through(scene, built, self.process, progress)
        if self.step_limit is not None:
            return refine(scene, built, self.refinement, progress, locked=True)
        relevel = (
            partial(levels_of_least_lost_light, scene, step_weight=self.step_weight)
            if self.placement == "light"
            else None
        )
        return refine(scene, built, self.refinement, progress, relevel)


def lenslets(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Heights whose rises along edges are nearest, in the least-squares sense, to those asked for.

    The normal equations are a Poisson problem on each facet's grid of vertices with free edges, which the cosine
    transform makes diagonal.

    Args:
        rows: (F, k, k - 1) rises from one column to the next, mm.
        columns: (F, k - 1, k) rises from one row to the next, mm.

    Returns:
        (F, k, k) float64 heights of zero mean per facet, mm.
    """
    matrix, eigenvalues = cosines(rows.shape[1])
    spectrum = matrix @ divergence(rows, columns) @ matrix.T
    spectrum /= np.where(eigenvalues > 0, eigenvalues, np.inf)  # the mean has no slope: it is zero
    return matrix.T @ spectrum @ matrix
