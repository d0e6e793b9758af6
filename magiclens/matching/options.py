"""The options that matchers share, so that their candidates are polished and evaluated alike."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from magiclens.contract.artifacts import Lens
from magiclens.contract.units import LengthOrPercent, relative
from magiclens.matching.tuples import Window

_LEAST = {"window": relative("0.1mm"), "step": relative("0.01mm")}
"""The least values of options; a share is compared as if its source were 100 mm wide."""
_MOST_MM, _MOST_SHARE = 20_000.0, 2.0
"""The largest values: all offsets between two points of the largest source."""
_LEAST_SCALE, _MOST_SCALE = 0.01, 100.0
"""Magnitudes of maps that lenslets may have."""


class MatchingOptions(BaseModel):
    """What ``polished`` must know. A matcher inherits from it, and with it these keys of its spec.

    Frozen and strict as a stage's options are. A subclass changes a default by declaring the field again.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)

    window: LengthOrPercent = Field(relative("10%"), description="side of the search window, of the source's width")
    candidates: int = Field(64, ge=1, le=400, description="candidates kept per facet, at most")
    acceptance: float = Field(
        0.05, gt=0, le=1e6, description="candidates worse than a facet's best by more than this error are dropped (4.2)"
    )
    pixels: Literal[4, 8, 16] = Field(8, description="pixels per tile side in the search, half of those in polishing")
    step: LengthOrPercent = Field(relative("0.13mm"), description="distance between neighbouring offsets")
    polish: int = Field(
        64, ge=0, le=400, description="candidates per facet that are polished; 0: lattice positions only"
    )

    @field_validator("window", "step")
    @classmethod
    def _neither_nothing_nor_endless(cls, value: LengthOrPercent, info: ValidationInfo) -> LengthOrPercent:
        least = _LEAST[str(info.field_name)]
        if value.value > (_MOST_SHARE if value.relative else _MOST_MM):
            raise ValueError(f"must be at most {_MOST_MM:g}mm, or {_MOST_SHARE:.0%}")
        if value.value < (least.value / 100 if value.relative else least.value):
            raise ValueError(f"must be at least {least}, or {least.value:g}%")
        return value

    def window_on(self, lens: Lens, buckets: int = 1) -> Window:
        """The search window of a lens's facets, mm, for kernels."""
        width = lens.source_size_mm
        return Window(self.window.mm(width) / 2, self.step.mm(width), buckets)


class LatticeOptions(MatchingOptions):
    """Options of a search that tries every offset of the window at every map of a lattice."""

    scales: tuple[float, ...] = Field(
        (0.1, 0.3, 0.8), min_length=1, description="magnitudes of the map along each axis"
    )
    maps: Literal["symmetric", "scale"] = Field(
        "symmetric", description="`scale`: the paper's isotropic scales only; `symmetric`: flips, anisotropy, shear"
    )

    @field_validator("scales")
    @classmethod
    def _magnitudes(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not all(_LEAST_SCALE <= scale <= _MOST_SCALE for scale in value):
            raise ValueError(f"scales are from {_LEAST_SCALE:g} to {_MOST_SCALE:g}; maps of either sign are tried")
        return value

    @property
    def isotropic(self) -> bool:
        """Whether only the paper's isotropic scales are tried."""
        return self.maps == "scale"
