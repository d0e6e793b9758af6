"""The ``multi-view`` scenario: one source, with another target for every eye (section 4.6, figure 12)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from magiclens.config.model import Choice, SpecModel, Viewer
from magiclens.contract.artifacts import FloatArray, Lens
from magiclens.contract.units import Angle, Length
from magiclens.scenarios.base import Scenario, Shot, azimuth_direction
from magiclens.scenarios.pictures import Source, Target


class EyeSpec(SpecModel):
    """Where an eye is, seen from the lens's centre: given by its direction or by its position."""

    tilt: Angle | None = Field(None, ge=0, lt=80, description="from straight above")
    azimuth: Angle | None = Field(
        None, ge=-3600, le=3600, description="of the tilt: 0deg is to the right, 90deg up the picture"
    )
    x: Length | None = Field(
        None, ge=-1e5, le=1e5, description="to the right of the lens's centre; with y and the viewer's distance"
    )
    y: Length | None = Field(None, ge=-1e5, le=1e5, description="above the lens's centre, as the viewer sees it")

    @model_validator(mode="after")
    def _one_way(self) -> EyeSpec:
        by_position, by_direction = self.x is not None or self.y is not None, self.tilt is not None
        if by_position == by_direction or (by_position and self.azimuth is not None):
            raise ValueError("say where the eye is: {tilt: 15deg, azimuth: 0deg} or {x: 100mm, y: 0mm}")
        return self

    def position_mm(self, lens: Lens, viewer: Viewer) -> FloatArray:
        """(3,) float64, mm, world frame. A tilted eye is as far from the lens's centre as the viewer."""
        if self.tilt is None:
            return np.array([self.x or 0.0, self.y or 0.0, lens.thickness_mm + viewer.distance])
        tilt = np.radians(self.tilt)
        from_centre = viewer.distance * np.append(np.sin(tilt) * azimuth_direction(self.azimuth or 0.0), np.cos(tilt))
        return np.array([0.0, 0.0, lens.thickness_mm]) + from_centre


class ViewSpec(SpecModel):
    """A target and the eye that shall see it."""

    target: Target = Field(description="what this eye shall see")
    eye: EyeSpec = Field(description="where the eye is: {tilt, azimuth} or {x, y}")


class MultiView(Scenario):
    """One lens that shows another picture to every eye."""

    type: ClassVar[str] = "multi-view"
    suitable_rematch: ClassVar[int] = 2  # heights move facets in the pictures of tilted eyes: it gains 1 dB

    source: Source = Field(
        description="what lies below the lens; larger than the lens, as tilted eyes look past its edges"
    )
    views: list[ViewSpec] = Field(min_length=1, max_length=16, description="what shall be seen from where")

    def suitable_stages(self) -> dict[str, Choice]:
        """The matcher for several eyes, and screening that holds facets near the reference plane.

        A facet above or below that plane is displaced in the pictures of tilted eyes.
        """
        return {"matcher": {"type": "multi-view"}, "annealer": {"type": "heat-bath", "screening": 1e-3}}

    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """One shot per eye, all of the same source."""
        return tuple(
            Shot(f"eye-{k}", self.source, view.target, view.eye.position_mm(lens, viewer), target_name=f"eye-{k}")
            for k, view in enumerate(self.views)
        )
