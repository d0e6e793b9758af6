"""The clear text encoding of STEP files (ISO 10303-21): numbered entities and their parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TextIO, TypeAlias

Parameter: TypeAlias = "Ref | Word | Derived | str | float | Iterable[Parameter] | None"
_WHEN = "1980-01-01T00:00:00"
"""Time in the header, which must have one: always the same, so that equal lenses give equal bytes."""
_SCHEMA = "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }"
"""Application protocol 214, which every CAD program reads."""


class Ref(int):
    """The number of an entity."""


class Word(str):
    """A word of an enumeration, such as ``UNSPECIFIED``; T and F are the logical ones."""


class Derived:
    """A parameter whose value follows from others."""


YES, NO, UNSPECIFIED, DERIVED = Word("T"), Word("F"), Word("UNSPECIFIED"), Derived()


class Part21:
    """Writes a file entity by entity, each with the next number."""

    def __init__(self, file: TextIO, name: str, description: str):
        self._file, self._count = file, 0
        by = encode(("magiclens",))
        file.write("ISO-10303-21;\nHEADER;\n")
        file.write(f"FILE_DESCRIPTION({encode((description,))},'2;1');\n")
        file.write(f"FILE_NAME({encode(name)},'{_WHEN}',{by},{by},'mlens-step','magiclens','');\n")
        file.write(f"FILE_SCHEMA({encode((_SCHEMA,))});\nENDSEC;\nDATA;\n")

    def add(self, entity: str, *parameters: Parameter) -> Ref:
        """Write a simple entity."""
        return self.add_complex(entity + encode(parameters))

    def add_complex(self, text: str) -> Ref:
        """Write an entity that is encoded already."""
        self._count += 1
        self._file.write(f"#{self._count}={text};\n")
        return Ref(self._count)

    def close(self) -> None:
        """Write the end."""
        self._file.write("ENDSEC;\nEND-ISO-10303-21;\n")


def encode(value: Parameter) -> str:
    """A parameter as text: references, words, text, reals, integers, lists, and $ for what is not given."""
    if value is None:
        return "$"
    if isinstance(value, Derived):
        return "*"
    if isinstance(value, Ref):
        return f"#{value:d}"
    if isinstance(value, Word):
        return f".{value}."
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, float):
        return _real(value)
    if isinstance(value, int):
        return str(value)
    return f"({','.join(map(encode, value))})"


def _real(value: float) -> str:
    """A real, with the decimal point that the standard demands."""
    mantissa, _, exponent = repr(value).partition("e")
    point = "" if "." in mantissa else "."
    return f"{mantissa}{point}E{exponent}" if exponent else mantissa + point
