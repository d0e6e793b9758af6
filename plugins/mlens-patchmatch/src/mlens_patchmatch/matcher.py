"""Approximate matching: guess at random, learn from neighbours, search around what is good."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from magiclens import Candidates, LengthOrPercent, Matcher, MatchingOptions, Progress, Scene, relative, silent


class PatchMatch(MatchingOptions, Matcher):
    """As many patches are compared in a large window as in a small one; the best are polished as by ``exhaustive``.

    Every facet keeps the best patch of each part of its window, so that the annealer has something to choose from.
    """

    type: ClassVar[str] = "patchmatch"

    window: LengthOrPercent = Field(relative("50%"), description="side of the search window, of the source's width")
    smallest: float = Field(0.07, gt=0, description="smallest magnitude of the map along an axis")
    largest: float = Field(1.2, gt=0, le=100, description="largest magnitude of the map along an axis")
    guesses: int = Field(2000, ge=1, le=100_000, description="random patches per part of the window, to start with")
    rounds: int = Field(6, ge=0, le=100, description="rounds of asking neighbours and searching around")

    @model_validator(mode="after")
    def _has_scales(self) -> PatchMatch:
        if self.smallest > self.largest:
            raise ValueError(f"smallest is {self.smallest:g} and largest {self.largest:g}; exchange them")
        return self

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Search and polish. Raises InputError when some facet reaches no patch, or views do not share an eye."""
        from magiclens import polished
        from mlens_patchmatch.search import search

        return polished(scene, search(self, scene, rng, progress), self)
