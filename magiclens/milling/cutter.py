"""Rotating cutters, and the ridges that they leave between lines."""

from __future__ import annotations

import math
import re
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.units import ANGLE, LENGTH, Angle, Length

TEXT = re.compile(r"(\S+) (ball|flat|v)(?:, (\S+), (round|flat) tip (\S+))?, reach (\S+)")


class Cutter(BaseModel):
    """A rotating cutter: ``ball`` (ball nose), ``flat`` (end mill) or ``v`` (engraving cutter, a cone with a tip)."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    shape: Literal["ball", "flat", "v"] = Field("ball", description="form of the cutting end")
    diameter: Length = Field("1mm", validate_default=True, gt=0, le=50, description="of its widest part")
    tip: Length | None = Field(None, ge=0, description="diameter of a v cutter's tip, 0.2mm if left out")
    tip_form: Literal["round", "flat"] | None = Field(None, description="of a v cutter's tip, round if left out")
    angle: Angle | None = Field(None, ge=5, le=170, description="between a v cutter's flanks, 30deg if left out")
    reach: Length = Field(
        "15mm", validate_default=True, gt=0, description="how deep it gets into a narrow hole before its holder touches"
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
        """Diameter of a v cutter's tip; 0 for others."""
        return 0.0 if self.shape != "v" else 0.2 if self.tip is None else self.tip

    @property
    def angle_deg(self) -> float:
        """Angle between a v cutter's flanks."""
        return 30.0 if self.angle is None else self.angle

    def outline(self) -> FloatArray:
        """The outline as of ``milling.outline``: (flat, round, slope, knee, rise, radius), mm."""
        import numpy as np

        radius, tip = self.diameter / 2, self.tip_mm / 2
        if self.shape == "ball":
            return np.array([0.0, radius, 0.0, radius, radius, radius])
        if self.shape == "flat":
            return np.array([radius, 0.0, 0.0, radius, 0.0, radius])
        half = math.radians(self.angle_deg / 2)
        if self.tip_form == "flat" or tip == 0:
            return np.array([tip, 0.0, 1 / math.tan(half), tip, 0.0, radius])
        return np.array([0.0, tip, 1 / math.tan(half), tip * math.cos(half), tip * (1 - math.sin(half)), radius])

    def __str__(self) -> str:
        form = f"{LENGTH.text(self.diameter)} {self.shape}"
        if self.shape == "v":
            form += f", {ANGLE.text(self.angle_deg)}, {self.tip_form or 'round'} tip {LENGTH.text(self.tip_mm)}"
        return f"{form}, reach {LENGTH.text(self.reach)}"

    @classmethod
    def parse(cls, text: str) -> Cutter:
        """The cutter that ``str`` describes. Raises ValueError if the text is none."""
        match = TEXT.fullmatch(text)
        if match is None:
            raise ValueError(f"{text!r} describes no cutter")
        diameter, shape, angle, form, tip, reach = match.groups()
        cone = {"angle": angle, "tip_form": form, "tip": tip} if shape == "v" else {}
        return cls.model_validate({"shape": shape, "diameter": diameter, "reach": reach, **cone})


def scallop_mm(outline: FloatArray, stepover_mm: float, slope: float = 0.0) -> float:
    """Height, measured upright, of the ridges that lines at ``stepover_mm`` leave on a plane.

    The plane climbs across the lines with a slope (a tangent). For a ball on a level plane this is the textbook's
    r - sqrt(r^2 - (s / 2)^2). Between two positions of the cutter the ridge is where both leave as much above the
    plane that they touch: ``rise(v) - slope v`` is the same at v and at v - stepover. inf if strips are left between.
    """
    from magiclens.milling.outline import rise_at, touch

    radius = float(outline[5])
    if stepover_mm > 2 * radius:
        return math.inf

    def left(v: float) -> float:
        return float(rise_at(outline, abs(v))) - slope * v if abs(v) <= radius else math.inf

    deepest = float(touch(outline, slope, 0.0)) if slope else 0.0
    low, high = deepest, deepest + stepover_mm
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if left(middle) < left(middle - stepover_mm) else (low, middle)
    return max(left(low), left(high - stepover_mm)) - left(deepest)
