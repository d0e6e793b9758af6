"""The matcher for several eyes: every normal of a lattice, seen by every eye through exact refraction (4.6)."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene
from magiclens.contract.stages import Matcher, Progress, silent
from magiclens.contract.units import LengthOrPercent, relative


class MultiView(Matcher):
    """Candidates whose errors count what every eye sees, in position and in shape; best per bucket; polished.

    The paper makes each view the master in turn and follows its patches to the other eyes. Here the lattice is that
    of the mean eye: it holds every normal that a master could ask for.
    """

    type: ClassVar[str] = "multi-view"

    window: LengthOrPercent = Field(relative("10%"), description="side of the search window, of the source's width")
    scales: tuple[float, ...] = Field(
        (0.1, 0.3, 0.8), min_length=1, description="magnitudes of the map along each axis"
    )
    maps: Literal["symmetric", "scale"] = Field(
        "symmetric", description="`scale`: the paper's isotropic scales only; `symmetric`: flips, anisotropy, shear"
    )
    candidates: int = Field(64, ge=1, le=400, description="candidates kept per facet, at most")
    acceptance: float = Field(
        0.05, gt=0, description="candidates worse than a facet's best by more than this error are dropped (4.2)"
    )
    step: LengthOrPercent = Field(relative("0.2mm"), description="distance between neighbouring offsets")
    pixels: Literal[4, 8, 16] = Field(8, description="pixels per tile side when polishing")
    polish: int = Field(64, ge=0, description="candidates per facet that are polished; 0: lattice positions only")

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Search, polish, judge. Raises InputError when some facet reaches no patch in every view."""
        from magiclens.matching.several_eyes import match

        return match(self, scene, np.zeros((scene.lens.facets,) * 2), progress)

    def rematch(
        self, scene: Scene, candidates: Candidates, assignment: Assignment, built: HeightField, traced: FloatArray,
        progress: Progress = silent,
    ) -> Candidates:  # fmt: skip
        """All candidates polished and judged again with every facet where it now stands: its height moves it about
        in the pictures of all eyes but the mean one."""
        from magiclens.matching.several_eyes import rematch

        return rematch(self, scene, candidates, built.levels_mm, progress)
