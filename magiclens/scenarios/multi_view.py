"""One source, another target for every eye (section 4.6, figure 12)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from magiclens.config.model import Choice, SpecModel, Viewer
from magiclens.contract.artifacts import FloatArray, Lens
from magiclens.contract.units import Angle, Length
from magiclens.scenarios.base import Scenario, Shot, toward
from magiclens.scenarios.pictures import Source, Target


class Eye(SpecModel):
    """Where an eye is, seen from the lens's centre: by direction, or by position."""

    tilt: Angle | None = Field(None, ge=0, lt=80, description="from straight above")
    azimuth: Angle | None = Field(None, description="of the tilt: 0deg is to the right, 90deg up the picture")
    x: Length | None = Field(None, description="to the right of the lens's centre; with y and the viewer's distance")
    y: Length | None = Field(None, description="above the lens's centre, as the viewer sees it")

    @model_validator(mode="after")
    def _one_way(self) -> Eye:
        placed, tilted = self.x is not None or self.y is not None, self.tilt is not None
        if placed == tilted or (placed and self.azimuth is not None):
            raise ValueError("say where the eye is: {tilt: 15deg, azimuth: 0deg} or {x: 100mm, y: 0mm}")
        return self

    def position_mm(self, lens: Lens, viewer: Viewer) -> FloatArray:
        """(3,) float64, world frame. A tilted eye is as far from the lens's centre as the viewer."""
        if self.tilt is None:
            return np.array([self.x or 0.0, self.y or 0.0, lens.thickness_mm + viewer.distance])
        tilt = np.radians(self.tilt)
        away = viewer.distance * np.append(np.sin(tilt) * toward(self.azimuth or 0.0), np.cos(tilt))
        return np.array([0.0, 0.0, lens.thickness_mm]) + away


class ViewSpec(SpecModel):
    """A target and the eye that shall see it."""

    target: Target = Field(description="what this eye shall see")
    eye: Eye = Field(description="where the eye is: {tilt, azimuth} or {x, y}")


class MultiView(Scenario):
    """Another picture from every eye."""

    type: ClassVar[str] = "multi-view"

    source: Source = Field(description="what lies below the lens; make it larger than the lens, as eyes look askew")
    views: list[ViewSpec] = Field(min_length=1, max_length=16, description="what shall be seen from where")

    def suited(self) -> dict[str, Choice]:
        """Facets that stand high or low move about in the pictures of tilted eyes, so they are held near the plane."""
        return {"matcher": {"type": "multi-view"}, "annealer": {"type": "heat-bath", "screening": 1e-3}}

    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """One per eye; all look at the same source."""
        return tuple(
            Shot(f"eye-{k}", self.source, view.target, view.eye.position_mm(lens, viewer), target_name=f"eye-{k}")
            for k, view in enumerate(self.views)
        )
