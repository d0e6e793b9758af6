"""The options that programs along straight lines have in common, whatever their language."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema, model_validator

from magiclens.contract.artifacts import Lens
from magiclens.contract.errors import InputError
from magiclens.contract.units import LENGTH, Length, Quantity
from magiclens.milling.cutter import Cutter
from magiclens.milling.exporter import MillingExporter

_SPEED = Quantity("a speed", "mm/min", {"mm/min": 1.0, "mm/s": 60.0, "m/min": 1000.0, "in/min": 25.4})

Speed = Annotated[
    float,
    BeforeValidator(_SPEED.parse),
    PlainSerializer(_SPEED.text, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string", "pattern": _SPEED.pattern}),
]
"""A speed: text such as ``800mm/min`` or ``15mm/s``; a float in mm per minute inside."""


_MOST_TILES = 64
"""Number of tiles above which a bed counts as too small."""
_SPARE_MM = 0.1
"""Tiles are smaller than the machine's bed by this length, since lines end a little outside."""
_MOST_LINES = 10**5
"""Most lines of an operation: they are a hundredth of a millimetre apart on a lens of a metre."""
_SHARPEST_MM = 0.01
"""Tips that are narrower count as points."""
_Side = Annotated[Length, Field(ge=0.01, le=1e5)]


class MillingOptions(MillingExporter):
    """The cutters, speeds and distances of roughing and finishing along straight lines."""

    operation: Literal["roughing", "finishing", "both"] = Field("both", description="what is done")
    cutter: Cutter = Field(
        Cutter.model_validate({"shape": "v", "diameter": "3mm"}),
        description="for finishing: its tip decides how sharp the borders between facets get",
    )
    rougher: Cutter | None = Field(
        Cutter.model_validate({"shape": "ball", "diameter": "3mm"}),
        description="for roughing; null: the cutter for finishing",
    )
    axis: Literal["x", "y"] = Field("x", description="direction of the lines")
    stepover: Length = Field("0.03mm", validate_default=True, ge=0.001, description="between the lines of finishing")
    tolerance: Length | None = Field(
        None, ge=1e-5, le=1,
        description="most that straight segments leave on the lens; if left out, a hundredth of the stepover, at most "
        "0.0005mm: lines side by side that differ by more tilt the surface that polishing leaves",
    )  # fmt: skip
    rough_stepover: Length | None = Field(
        None, ge=0.001, description="between the lines of roughing, 0.4 of the cutter's diameter (its tip's, of a v)"
    )
    rough_stepdown: Length | None = Field(
        None, ge=0.001, le=1000, description="between the levels of roughing, half the cutter's diameter if left out"
    )
    allowance: Length = Field(
        "0.1mm", validate_default=True, ge=0, le=100, description="what roughing leaves for finishing"
    )
    safe_height: Length = Field(
        "5mm", validate_default=True, ge=0.01, le=1000, description="above the plate, where it travels"
    )
    feed: Speed = Field("1200mm/min", validate_default=True, ge=1, le=1e6, description="while cutting")
    plunge: Speed = Field("300mm/min", validate_default=True, ge=1, le=1e6, description="straight down")
    spindle: int = Field(12000, ge=1, le=1_000_000, description="turns per minute")
    stock: Length | None = Field(
        None, ge=0.1, le=2000, description="thickness of the plate, the lens's highest point if left out"
    )
    bed: tuple[_Side, _Side] | None = Field(
        None, description="the machine's travel in x and y; a lens that is larger is milled in tiles, a file for each"
    )

    step_mm: ClassVar[float]
    """The machine's step, mm: every coordinate is a multiple of it."""

    @model_validator(mode="after")
    def _fits_together(self) -> MillingOptions:
        for name, over, cutter in (
            ("stepover", self.stepover, self.cutter),
            ("rough_stepover", self.rough_stepover_mm, self.roughing_cutter),
        ):
            if over > cutter.diameter:
                whole = LENGTH.text(cutter.diameter)
                wish = f"a {name} of {LENGTH.text(over)} leaves strips between the lines"
                raise ValueError(f"{wish} of a {whole} cutter; at most {whole}")
        numbers = [number for number, _ in self.cutters.values()]
        if self.rougher not in (None, self.cutter) and len(numbers) > len(set(numbers)):
            raise ValueError(f"cutter and rougher are different tools with the same number {numbers[0]}")
        return self

    @property
    def cutters(self) -> dict[str, tuple[int, Cutter]]:
        """Number and cutter of each operation, in the order of the operations."""
        two = self.operation == "both" and self.rougher not in (None, self.cutter)
        every = {
            "roughing": (self.roughing_cutter.number or 1, self.roughing_cutter),
            "finishing": (self.cutter.number or (2 if two else 1), self.cutter),
        }
        return every if self.operation == "both" else {self.operation: every[self.operation]}

    @property
    def changes_cutters(self) -> bool:
        """Whether a program may ask for another cutter; if not, there is a file for each cutter."""
        return False

    @property
    def roughing_cutter(self) -> Cutter:
        """The cutter for roughing."""
        return self.rougher or self.cutter

    @property
    def tolerance_mm(self) -> float:
        """Most that straight segments leave on the lens, mm: at least the machine's step."""
        return max(self.tolerance or min(self.stepover / 100, 0.0005), self.step_mm)

    @property
    def rough_stepover_mm(self) -> float:
        """Distance between the lines of roughing, mm."""
        cutter = self.roughing_cutter
        # lines as far apart as a tip that is a point are too many
        flat = cutter.tip_mm if cutter.tip_mm >= _SHARPEST_MM else 0.0
        return self.rough_stepover or flat or 0.4 * cutter.diameter

    @property
    def rough_stepdown_mm(self) -> float:
        """Distance between the levels of roughing, mm."""
        return self.rough_stepdown or self.roughing_cutter.diameter / 2

    def require_possible(self, lens: Lens) -> None:
        """A flat lens must fit plate, cutters and bed; what its top adds is known when it is designed."""
        if lens.mark:
            why = "a mill cuts the top alone, so it leaves no mark at the foot"
            raise InputError(f"{why}; set lens.mark to false", keys=("lens.mark",))
        self.require_depth(lens.thickness_mm, lens.thickness_mm, self.stock or lens.thickness_mm)
        self.tiles_of((lens.size_mm, lens.size_mm), self.bed)
        for key, over in (("stepover", self.stepover), ("rough_stepover", self.rough_stepover_mm)):
            if (lines := int(lens.size_mm / over)) > _MOST_LINES:
                wish = f"there would be {lines:,} lines, more than {_MOST_LINES:,}"
                raise InputError(f"{wish}; make it wider", keys=(key,))

    def require_depth(self, lowest_mm: float, highest_mm: float, plate_mm: float) -> None:
        """Raise InputError if a plate is too thin for a top between two heights, or a cutter too short."""
        if plate_mm < highest_mm - 1e-9:
            need, has = LENGTH.text(math.ceil(highest_mm * 100) / 100), LENGTH.text(plate_mm)
            raise InputError(f"the plate of {has} is thinner than the lens; it needs {need}", keys=("stock",))
        depth = plate_mm - lowest_mm
        for name, (_, cutter) in self.cutters.items():
            if cutter.reach < depth:
                need, has = LENGTH.text(math.ceil(depth * 10) / 10), LENGTH.text(cutter.reach)
                raise InputError(
                    f"the cutter for {name} reaches {has} deep, the lens needs {need}",
                    keys=("rougher" if name == "roughing" else "cutter",),
                )

    def tiles_of(self, sides_mm: tuple[float, float], bed_mm: tuple[float, float] | None) -> tuple[int, int]:
        """Columns and rows of the tiles of a square that fit a bed. Raises InputError if they are too many."""
        columns, rows = (_share(side, most) for side, most in zip(sides_mm, bed_mm or (math.inf,) * 2, strict=True))
        if columns * rows > _MOST_TILES:
            has = " x ".join(LENGTH.text(side) for side in self.bed or ())
            message = f"a bed of {has} would take more than {_MOST_TILES} tiles; use a larger one"
            raise InputError(message, keys=("bed",))
        return columns, rows


def _share(side: float, most: float) -> int:
    """Number of equal parts of a side, mm, that each fit ``most`` mm; more than are allowed if ``most`` is tiny."""
    return max(math.ceil(side / (most - _SPARE_MM)), 1) if most > _SPARE_MM else _MOST_TILES + 1
