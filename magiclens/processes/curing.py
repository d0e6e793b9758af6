"""How deep light cures resin."""

from __future__ import annotations

import math

from pydantic import BaseModel, ConfigDict, Field, model_validator

from magiclens.contract.units import Length


class Cure(BaseModel):
    """Resin and exposure of a printer that cures by light.

    Light falls on the layer that is being made and goes on into what lies below. Where that is solid it changes
    nothing, so a top that faces the light is as high as its layers are, with a skin that has had less light than the
    rest. Below what overhangs there is resin, and it cures to the depth ``Cd = Dp ln(E / Ec)`` (P. F. Jacobs, "Rapid
    Prototyping & Manufacturing", 1992): there the part grows.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    penetration: Length = Field(ge=1e-3, le=10, description="Dp: depth at which 1/e of the light is left")
    critical: float = Field(ge=0.01, le=1e4, description="Ec: exposure from which resin is solid, mJ/cm2")
    exposure: float = Field(ge=0.01, le=1e6, description="E: exposure of a layer, mJ/cm2")

    @model_validator(mode="after")
    def _cures(self) -> Cure:
        if self.exposure <= self.critical:
            raise ValueError(f"an exposure of {self.exposure:g} mJ/cm2 cures nothing; more than critical is needed")
        return self

    @property
    def depth_mm(self) -> float:
        """Cd, from the side of a layer that faces the light."""
        return self.penetration * math.log(self.exposure / self.critical)

    def below_mm(self, layer_mm: float) -> float:
        """How far a part grows below an overhang, by layers of this height."""
        return max(self.depth_mm - layer_mm, 0.0)
