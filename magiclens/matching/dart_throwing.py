"""Dart throwing: facets draw regions of the source at random, no two the same, whatever is to be shown (5.1)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene
from magiclens.contract.stages import Matcher, Progress, silent
from magiclens.contract.units import LengthOrPercent, relative


class DartThrowing(Matcher):
    """One sub-region per facet, seen in the four ways it can be mirrored; no pictures are needed."""

    type: ClassVar[str] = "dart-throwing"
    uses_pictures: ClassVar[bool] = False

    subdivisions: int = Field(2, ge=1, le=8, description="sub-regions along one side of a facet's patch of the source")
    reach: LengthOrPercent = Field(
        relative("5%"), description="farthest a facet may look along each axis, of the source's width"
    )
    guard: LengthOrPercent = Field(
        relative("4%"), description="rim of a sub-region that is not looked at, of the sub-region's side"
    )

    sweeps: int = Field(
        20, ge=0, description="sweeps of drawing again where walls between facets would take light; 0: the plain draw"
    )

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Draw, all errors 0. Raises InputError when the facets cannot all get one."""
        from magiclens.matching.darts import match

        return match(self, scene, rng)

    def rematch(
        self, scene: Scene, candidates: Candidates, assignment: Assignment, built: HeightField, traced: FloatArray,
        progress: Progress = silent,
    ) -> Candidates:  # fmt: skip
        """The same: pictures that are painted for the finished lens say nothing about it before."""
        return candidates
