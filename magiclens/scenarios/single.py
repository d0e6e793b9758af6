"""The ``single`` scenario: one source and one target (sections 4.2 to 4.5, figures 4 and 11)."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from magiclens.config.model import Viewer
from magiclens.contract.artifacts import Lens
from magiclens.scenarios.base import Scenario, Shot
from magiclens.scenarios.pictures import Source, Target


class Single(Scenario):
    """One lens that shows one picture over one source."""

    type: ClassVar[str] = "single"

    source: Source = Field(description="what lies below the lens")
    target: Target = Field(description="what the eye shall see")

    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """The only shot."""
        return (Shot("single", self.source, self.target, viewer.eye_mm(lens)),)
