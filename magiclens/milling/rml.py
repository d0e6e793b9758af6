"""Milling programs in Roland's RML-1 as its engravers of the EGX class take it, written and read back.

The commands are those of Roland's "RML-1 Programing Guideline" (version 1.00, 2002): coordinates in 1/100 mm; ``PA``
absolute coordinates; ``!MC1`` and ``!MC0`` spindle on and off; ``VS`` and ``!VZ`` speeds in mm per second, of the
plane and of the z axis; ``!PZ z1,z2`` heights of the lowered and of the raised cutter; ``PU x,y`` raises it to z2 and
travels there; ``Z x,y,z`` is a straight move of all three axes. The language has no comments and no tool change.
Machines differ in which of the two speeds rules a ``Z``, so both are always set to the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar

from magiclens.contract.errors import InputError
from magiclens.milling.line_milling import LineMilling

if TYPE_CHECKING:
    from magiclens.milling.program import MillingProgram, MillingSetup
    from magiclens.milling.toolpath import Moves

_UNIT_MM = 0.01
"""Unit of coordinates."""
_COMMAND = re.compile(r"(PA|PU|Z|VS|!VZ|!PZ|!MC)((?:-?\d+(?:\.\d+)?)?(?:,-?\d+(?:\.\d+)?)*)$")
"""A command: its name, and its arguments between commas."""
_COUNT = {"PA": 0, "PU": 2, "Z": 3, "VS": 1, "!VZ": 1, "!PZ": 2, "!MC": 1}
"""Number of arguments of each command that ``parse_rml`` understands."""


class Rml(LineMilling):  # noqa: D101 - the docstring goes on with that of the base
    __doc__ = f"""Roland RML-1, in steps of 0.01 mm, a file for each cutter. {LineMilling.__doc__}"""

    type: ClassVar[str] = "rml"
    suffix: ClassVar[str] = ".rml"
    step_mm: ClassVar[float] = _UNIT_MM

    def write(self, program: MillingProgram, comments: list[str]) -> str:
        """The program as text; RML-1 has no comments."""
        return "\n".join(["PA;PA;", *self._body(program), "!MC0;", ""])

    def parse(self, text: str, setup: MillingSetup) -> Moves:
        """The moves, all with the one cutter of the setup. Raises InputError, see ``parse_rml``."""
        return parse_rml(text, min(setup.tools))

    def _body(self, program: MillingProgram) -> Iterator[str]:
        moves, speed = program.moves, 0.0
        yield f"!PZ0,{_units(self.safe_height)};!MC1;"
        for (x, y, z), feed in zip(moves.points.tolist(), moves.feed.tolist(), strict=True):
            if feed and feed != speed:
                speed = feed
                yield f"VS{feed / 60:.4g};!VZ{feed / 60:.4g};"  # mm per second; feeds are per minute
            across = f"{_units(x)},{_units(y)}"
            # rapid moves are at the safe height, to which PU raises the cutter
            yield f"Z{across},{_units(z)};" if feed else f"PU{across};"


def _units(mm: float) -> int:
    """A coordinate in the language's units."""
    return round(mm / _UNIT_MM)


def parse_rml(text: str, tool: int = 1) -> Moves:
    """The moves of a program, with the cutter of this number. Raises InputError naming the first line that is wrong."""
    reader = _Reader()
    for number, line in enumerate(text.splitlines(), 1):
        for command in filter(None, line.replace(" ", "").split(";")):
            try:
                reader.read(command)
            except ValueError as error:
                raise InputError(f"{error} in {command!r}", f"line {number}") from None
    return reader.moves(tool)


class _Reader:
    """The state of a machine that reads a program."""

    def __init__(self) -> None:
        self._at: tuple[float, float, float] | None = None
        self._up: float | None = None
        self._speeds = {"VS": 0.0, "!VZ": 0.0}
        self._moves: list[tuple[float, float, float, float]] = []

    def read(self, command: str) -> None:
        """One command without its terminator."""
        match = _COMMAND.match(command)
        if match is None:
            raise ValueError("not understood")
        name, numbers = match[1], [float(n) for n in match[2].split(",") if n]
        if len(numbers) != _COUNT[name]:
            raise ValueError(f"{len(numbers)} numbers")
        if name in self._speeds:
            self._speeds[name] = numbers[0] * 60
        elif name == "!PZ":
            self._up = numbers[1] * _UNIT_MM
        elif name == "PU":
            self._travel(numbers[0] * _UNIT_MM, numbers[1] * _UNIT_MM)
        elif name == "Z":
            self._cut((numbers[0] * _UNIT_MM, numbers[1] * _UNIT_MM, numbers[2] * _UNIT_MM))

    def _travel(self, x: float, y: float) -> None:
        """Up first, then across."""
        if self._up is None:
            raise ValueError("the raised height is not known yet")
        if self._at:
            self._go((*self._at[:2], self._up), 0.0)
        self._go((x, y, self._up), 0.0)

    def _cut(self, to: tuple[float, float, float]) -> None:
        upright = self._at is not None and self._at[:2] == to[:2]
        speed = self._speeds["!VZ" if upright else "VS"]
        if speed <= 0:
            raise ValueError("a move before any speed")
        self._go(to, speed)

    def _go(self, to: tuple[float, float, float], feed: float) -> None:
        self._at = to
        self._moves.append((*to, feed))

    def moves(self, tool: int) -> Moves:
        """All moves that were read."""
        import numpy as np

        from magiclens.milling.toolpath import Moves

        table = np.array(self._moves, float).reshape(-1, 4)
        return Moves(table[:, :3], table[:, 3], np.full(len(table), tool)).without_pauses()
