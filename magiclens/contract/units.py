"""Types of options with a unit: text in a spec, plain millimetres, degrees and fractions in the program.

``Length``, ``Angle`` and ``Fraction`` annotate pydantic fields: they take text such as ``10cm``, hold a float, and
turn back into text when a model is dumped as JSON. Defaults are text too: ``Field("5mm", validate_default=True)``. Type
checkers accept a default of another type only where the field itself says ``validate_default=True``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, GetCoreSchemaHandler, GetJsonSchemaHandler, PlainSerializer, WithJsonSchema
from pydantic_core import CoreSchema, core_schema

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"


@dataclass(frozen=True)
class Quantity:
    """A kind of measure.

    Attributes:
        noun: What messages call it, such as ``a length``.
        written: The unit in which values are written, such as ``mm``.
        units: Every unit that is read, with its size in the unit that is used inside.
    """

    noun: str
    written: str
    units: Mapping[str, float]

    @property
    def pattern(self) -> str:
        """Regular expression of the text that is accepted, for Python and for JSON Schema (ECMA 262)."""
        return rf"^({_NUMBER}) ?({'|'.join(self.units)})$"

    def text(self, value: float) -> str:
        """A value as a spec writes it; ``parse`` gives the same float again."""
        return f"{_digits(value / self.units[self.written])}{self.written}"

    def parse(self, value: object) -> float:
        """The value of a text such as ``10cm``; a ValueError says what is wrong and what was probably meant."""
        if _is_number(value):
            raise ValueError(f"{value} is a bare number; {self.noun} needs a unit, such as '{self._guess(value)}'")
        match = isinstance(value, str) and re.match(self.pattern, value.strip())
        if not match:
            raise ValueError(self._why_not(value))
        number = float(_digits(float(match[1]) * self.units[match[2]]))
        if not math.isfinite(number):
            raise ValueError(f"{value!r} is too large for {self.noun}")
        return number

    def _why_not(self, value: object) -> str:
        number = re.match(rf"({_NUMBER})\s*(.*)$", value.strip()) if isinstance(value, str) else None
        if number is None:
            got = "nothing" if value is None else repr(value)
            return f"expected {self.noun} such as '{self._guess(10)}', got {got}"
        choices = f"{self.noun} is in {', '.join(self.units)}, such as '{self._guess(number[1])}'"
        return f"unknown unit {number[2]!r} in {value!r}; {choices}"

    def _guess(self, number: object) -> str:
        value = float(str(number))
        # a bare 0.1 was most probably meant as a fraction, so as 10%; a bare 10 as 10%
        return self.text(value) if self.written == "%" and abs(value) <= 1 else f"{_digits(value)}{self.written}"


def _is_number(value: object) -> bool:
    if isinstance(value, bool):  # a kind of int in Python
        return False
    return isinstance(value, int | float) or (isinstance(value, str) and bool(re.fullmatch(_NUMBER, value.strip())))


def _digits(value: float) -> str:
    """A number with twelve significant digits, so that 0.1 + 0.2 is 0.3."""
    return f"{value:.12g}"


LENGTH = Quantity("a length", "mm", {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "µm": 1e-3, "in": 25.4})
"""Lengths, in millimetres inside."""

ANGLE = Quantity("an angle", "deg", {"deg": 1.0, "rad": math.degrees(1.0), "mrad": math.degrees(1e-3)})
"""Angles, in degrees inside."""

FRACTION = Quantity("a share", "%", {"%": 0.01})
"""Shares of something, from 0 to 1 inside."""


def _schema(*quantities: Quantity) -> dict[str, Any]:
    return {"type": "string", "pattern": "|".join(q.pattern for q in quantities)}


Length = Annotated[
    float,
    BeforeValidator(LENGTH.parse),
    PlainSerializer(LENGTH.text, return_type=str, when_used="json"),
    WithJsonSchema(_schema(LENGTH)),
]
"""A length: text such as ``100mm``, ``10cm``, ``0.1m``, ``2um`` or ``1in``; a float in millimetres inside."""

Angle = Annotated[
    float,
    BeforeValidator(ANGLE.parse),
    PlainSerializer(ANGLE.text, return_type=str, when_used="json"),
    WithJsonSchema(_schema(ANGLE)),
]
"""An angle: text such as ``90deg``, ``0.02rad`` or ``5mrad``; a float in degrees inside."""

Fraction = Annotated[
    float,
    BeforeValidator(FRACTION.parse),
    PlainSerializer(FRACTION.text, return_type=str, when_used="json"),
    WithJsonSchema(_schema(FRACTION)),
]
"""A share: text such as ``10%``; a float inside, here 0.1."""


@dataclass(frozen=True)
class LengthOrPercent:
    """A length such as ``5mm``, or a share such as ``10%`` of a length that is known later.

    Attributes:
        value: Millimetres, or the share.
        relative: Whether it is a share.
    """

    value: float
    relative: bool = False

    @classmethod
    def parse(cls, value: object) -> LengthOrPercent:
        """The value of a text; a ValueError says what is wrong."""
        if isinstance(value, cls):  # a default, which ``relative`` has made
            return value
        if _is_number(value):
            raise ValueError(f"{value} is a bare number; write a length such as '{value}mm' or a share such as '10%'")
        if isinstance(value, str) and value.strip().endswith("%"):
            return cls(FRACTION.parse(value), relative=True)
        return cls(LENGTH.parse(value))

    def mm(self, of_mm: float) -> float:
        """The length in millimetres; a share is one of ``of_mm``."""
        return self.value * of_mm if self.relative else self.value

    def __str__(self) -> str:
        return (FRACTION if self.relative else LENGTH).text(self.value)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        text = core_schema.plain_serializer_function_ser_schema(str, when_used="json")
        return core_schema.no_info_plain_validator_function(cls.parse, serialization=text)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return _schema(LENGTH, FRACTION)


def relative(text: str) -> LengthOrPercent:
    """A default of an option that is a LengthOrPercent, such as ``relative("10%")``."""
    return LengthOrPercent.parse(text)
