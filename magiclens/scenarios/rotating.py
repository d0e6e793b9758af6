"""The ``rotating`` scenario: one source, with one target per quarter turn of the lens (section 4.6, figure 1)."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from magiclens.config.model import Viewer
from magiclens.contract.artifacts import Lens
from magiclens.contract.units import ANGLE, Angle
from magiclens.scenarios.base import Scenario, Shot
from magiclens.scenarios.pictures import Source, Target


def _quarter(angle_deg: float) -> float:
    if angle_deg % 90:
        near = ANGLE.text(90 * round(angle_deg / 90))
        raise ValueError(f"'{ANGLE.text(angle_deg)}' is no quarter turn; the nearest is '{near}'")
    return angle_deg


class Rotating(Scenario):
    """One lens that shows another picture after every quarter turn, counter-clockwise as the viewer sees it."""

    type: ClassVar[str] = "rotating"

    source: Source = Field(description="what lies below the lens")
    targets: list[Target] = Field(min_length=1, max_length=4, description="what the eye shall see, one per angle")
    angles: list[Annotated[Angle, AfterValidator(_quarter)]] = Field(
        default_factory=lambda data: [f"{90 * k}deg" for k in range(len(data.get("targets", ())))],
        validate_default=True,
        description="lens rotations, multiples of 90deg; 0deg, 90deg, ... by default",
    )

    @field_validator("angles")
    @classmethod
    def _one_per_target(cls, angles: list[float], info: ValidationInfo) -> list[float]:
        targets = len(info.data.get("targets", angles))
        if len(angles) != targets:
            raise ValueError(f"{len(angles)} angles for {targets} targets; write one angle per target")
        if len({a % 360 for a in angles}) < len(angles):
            raise ValueError("two targets have the same angle; write different ones, such as 0deg and 90deg")
        return angles

    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """One shot per angle, all of the same source, seen by the same eye."""
        eye_mm = viewer.eye_mm(lens)
        names = [f"rotation-{a % 360:03.0f}" for a in self.angles]
        return tuple(
            Shot(name, self.source, target, eye_mm, angle % 360, target_name=name)
            for name, target, angle in zip(names, self.targets, self.angles, strict=True)
        )
