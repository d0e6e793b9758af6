"""A milling program: its moves, and what must be known to run it, as text that can be read back."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.milling.cutter import Cutter
from magiclens.milling.moves import Moves

NUMBER = r"(-?[\d.]+|inf)"
ZERO = re.compile(rf"zero: x = {NUMBER}, y = {NUMBER} of the lens, z = {NUMBER} above its bottom")
CUTTER = re.compile(r"(roughing|finishing): cutter (\d+), (.+)")
LEFT = re.compile(rf"stock left where the cutter reaches: at most {NUMBER} um")


@dataclass(frozen=True)
class Facts:
    """What the moves alone do not tell.

    cutters: number and shape of each operation's cutter, in order. zero_mm: x, y, z of the program's origin in the
    lens frame; z is the plate's top. left_mm: the most that finishing lines leave standing where the cutter's shape
    lets it reach, inf if nothing is finished.
    """

    cutters: Mapping[str, tuple[int, Cutter]] = field(default_factory=dict)
    zero_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    left_mm: float = float("inf")

    def lines(self) -> list[str]:
        """As text, for people and for ``read``."""
        x, y, z = (f"{value + 0.0:.12g}" for value in self.zero_mm)
        uses = [f"{name}: cutter {number}, {cutter}" for name, (number, cutter) in self.cutters.items()]
        left = f"stock left where the cutter reaches: at most {self.left_mm * 1000:.6g} um"
        zero = f"zero: x = {x}, y = {y} of the lens, z = {z} above its bottom"
        return [zero, *uses, *([left] if "finishing" in self.cutters else [])]

    @classmethod
    def read(cls, lines: Iterable[str]) -> Facts:
        """From text that contains such lines among others. Raises InputError if it does not say where zero is."""
        zero, cutters, left = None, {}, float("inf")
        for line in map(str.strip, lines):
            if match := ZERO.fullmatch(line):
                zero = float(match[1]), float(match[2]), float(match[3])
            elif match := CUTTER.fullmatch(line):
                cutters[match[1]] = int(match[2]), Cutter.parse(match[3])
            elif match := LEFT.fullmatch(line):
                left = float(match[1]) / 1000
        if zero is None or not cutters:
            raise InputError("it is not said where zero is or what cuts; keep what the exporter has written")
        return cls(cutters, zero, left)

    @property
    def tools(self) -> dict[int, Cutter]:
        """The cutters by their numbers."""
        return dict(self.cutters.values())


@dataclass(frozen=True)
class Program:
    """What a machine runs without a hand on it. Moves are in the program's own frame."""

    moves: Moves
    facts: Facts

    @cached_property
    def cuts(self) -> tuple[tuple[Cutter, FloatArray], ...]:
        """Each cutter and its straight moves at feed speed (K, 6): from and to, mm, lens frame."""
        moves = self.moves.shifted(self.facts.zero_mm)
        return tuple((cutter, moves.lines(number)) for number, cutter in self.facts.tools.items())
