"""Rotating cutters, as options and as text."""

from __future__ import annotations

import math
import re
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from magiclens.contract.units import ANGLE, LENGTH, Angle, Length
from magiclens.milling.outline import Outline

_TEXT = re.compile(r"(\S+) (ball|flat|v)(?:, (\S+), (round|flat) tip (\S+))?, reach (\S+)")
"""A cutter as text: diameter, shape, for a v cutter angle and tip, and reach."""


class Cutter(BaseModel):
    """A rotating cutter: ``ball`` (ball nose), ``flat`` (end mill) or ``v`` (engraving cutter, a cone with a tip)."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    shape: Literal["ball", "flat", "v"] = Field("ball", description="form of the cutting end")
    diameter: Length = Field("1mm", validate_default=True, ge=0.001, le=50, description="of its widest part")
    tip: Length | None = Field(None, ge=0, description="diameter of a v cutter's tip, 0.2mm if left out")
    tip_form: Literal["round", "flat"] | None = Field(None, description="of a v cutter's tip, round if left out")
    angle: Angle | None = Field(None, ge=5, le=170, description="between a v cutter's flanks, 30deg if left out")
    reach: Length = Field(
        "15mm",
        validate_default=True,
        ge=0.01,
        le=1000,
        description="how deep it gets into a narrow hole before its holder touches",
    )
    number: int | None = Field(
        None, ge=1, le=99, description="its place in the tool table; if left out 1, or 2 for finishing after another"
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Cutter:
        given = [name for name in ("tip", "tip_form", "angle") if getattr(self, name) is not None]
        if self.shape != "v" and given:
            raise ValueError(f"only a v cutter has {' and '.join(given)}; this one is {self.shape}")
        if self.tip_mm >= self.diameter:
            tip, whole = LENGTH.text(self.tip_mm), LENGTH.text(self.diameter)
            raise ValueError(f"a tip of {tip} does not fit a cutter of {whole}; make the tip smaller")
        return self

    @property
    def tip_mm(self) -> float:
        """Diameter of a v cutter's tip, mm; 0 for other cutters."""
        return 0.0 if self.shape != "v" else 0.2 if self.tip is None else self.tip

    @property
    def angle_deg(self) -> float:
        """Angle between a v cutter's flanks, degrees."""
        return 30.0 if self.angle is None else self.angle

    def outline(self) -> Outline:
        """The cutter's cross-section."""
        radius, tip = self.diameter / 2, self.tip_mm / 2
        if self.shape == "ball":
            return Outline(0.0, radius, 0.0, radius, radius, radius)
        if self.shape == "flat":
            return Outline(radius, 0.0, 0.0, radius, 0.0, radius)
        half = math.radians(self.angle_deg / 2)
        if self.tip_form == "flat" or tip == 0:
            return Outline(tip, 0.0, 1 / math.tan(half), tip, 0.0, radius)
        # the tip's ball ends where it is as steep as the cone
        return Outline(0.0, tip, 1 / math.tan(half), tip * math.cos(half), tip * (1 - math.sin(half)), radius)

    def __str__(self) -> str:
        form = f"{LENGTH.text(self.diameter)} {self.shape}"
        if self.shape == "v":
            form += f", {ANGLE.text(self.angle_deg)}, {self.tip_form or 'round'} tip {LENGTH.text(self.tip_mm)}"
        return f"{form}, reach {LENGTH.text(self.reach)}"

    @classmethod
    def parse(cls, text: str) -> Cutter:
        """The cutter that ``str(cutter)`` describes. Raises ValueError if the text is no such description."""
        match = _TEXT.fullmatch(text)
        if match is None:
            raise ValueError(f"{text!r} describes no cutter")
        diameter, shape, angle, form, tip, reach = match.groups()
        cone = {"angle": angle, "tip_form": form, "tip": tip} if shape == "v" else {}
        return cls.model_validate({"shape": shape, "diameter": diameter, "reach": reach, **cone})
