"""The exhaustive matcher: every offset of the search window at every map of a scale grid, then polishing (4.2)."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Candidates, Scene
from magiclens.contract.stages import Matcher, Progress, silent
from magiclens.contract.units import LengthOrPercent, relative


class Exhaustive(Matcher):
    """Exact search over offsets and axis-aligned maps, pruned by a lower bound; best per bucket; polished."""

    type: ClassVar[str] = "exhaustive"
    version: ClassVar[str] = "2"

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
    pixels: Literal[4, 8, 16] = Field(8, description="pixels per tile side in the search")
    step: LengthOrPercent = Field(relative("0.13mm"), description="distance between neighbouring offsets")
    polish: int = Field(64, ge=0, description="candidates per facet that are polished; 0: lattice positions only")

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Search, polish, sort. Raises InputError when some facet reaches no patch at all."""
        return self.match_rows(scene, 0, scene.lens.facets, progress)

    def match_rows(self, scene: Scene, first: int, last: int, progress: Progress = silent) -> Candidates:
        """What ``match`` finds for the facets in rows ``first`` to ``last - 1``: arrays (last - first, N, K, ...).

        What is found for a facet does not depend on the others, so that blocks of rows can be matched anywhere.
        """
        from magiclens.matching.driver import match

        return match(self, scene, slice(first, last), progress)
