"""Materials: their index of refraction, for the design, and density and price, for estimates of cost."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from pydantic import BaseModel, ConfigDict, Field

from magiclens.profiles.data import read_data


class Material(BaseModel):
    """One entry of ``materials.yaml``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = Field(min_length=1, description="what it is, in words")
    ior: float = Field(gt=1, le=4, description="index of refraction at 589 nm")
    density: float = Field(gt=0, description="g/cm3")
    price: float = Field(ge=0, description="EUR per kg, an estimate for small amounts")
    source: str = Field(min_length=1, description="where the index comes from")


@cache
def materials() -> Mapping[str, Material]:
    """Every material by its name in specs."""
    entries = read_data("materials.yaml").items()
    return MappingProxyType({name: Material.model_validate(entry) for name, entry in entries})
