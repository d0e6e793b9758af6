"""The ``multi-pair`` scenario: several sources, with another target for each (section 4.6)."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from magiclens.config.model import SpecModel, Viewer
from magiclens.contract.artifacts import Lens
from magiclens.scenarios.base import Scenario, Shot
from magiclens.scenarios.pictures import Source, Target


class Pair(SpecModel):
    """A source, and what the eye shall see when it lies below the lens."""

    source: Source = Field(description="what lies below the lens")
    target: Target = Field(description="what the eye shall see")


class MultiPair(Scenario):
    """One lens for several sources; it shows another picture over each."""

    type: ClassVar[str] = "multi-pair"

    pairs: list[Pair] = Field(min_length=1, max_length=8, description="sources and their targets")

    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """One shot per pair, all seen by the same eye."""
        eye_mm = viewer.eye_mm(lens)
        names = [f"pair-{k}" for k in range(len(self.pairs))]
        return tuple(
            Shot(name, pair.source, pair.target, eye_mm, source_name=name, target_name=name)
            for name, pair in zip(names, self.pairs, strict=True)
        )
