"""A milling program: its moves, and its setup, as text that can be read back."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.milling.cutter import Cutter
from magiclens.milling.toolpath import Moves

_NUMBER = r"(-?[\d.]+|inf)"
_ZERO = re.compile(rf"zero: x = {_NUMBER}, y = {_NUMBER} of the lens, z = {_NUMBER} above its bottom")
_CUTTER = re.compile(r"(roughing|finishing): cutter (\d+), (.+)")
_LEFT = re.compile(rf"stock left where the cutter reaches: at most {_NUMBER} um")


@dataclass(frozen=True)
class MillingSetup:
    """What must be known of a program besides its moves.

    Attributes:
        cutters: Number and shape of each operation's cutter (``roughing``, ``finishing``), in the order of the
            operations.
        zero_mm: x, y, z of the program's origin in the lens frame; z is the plate's top.
        left_mm: The most that finishing lines leave standing where the cutter's shape lets it reach, inf if nothing is
            finished.
    """

    cutters: Mapping[str, tuple[int, Cutter]] = field(default_factory=dict)
    zero_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    left_mm: float = float("inf")

    def to_text(self) -> list[str]:
        """Lines of text, for people and for ``from_text``."""
        # + 0.0 turns -0.0 into 0.0
        x, y, z = (f"{value + 0.0:.12g}" for value in self.zero_mm)
        uses = [f"{name}: cutter {number}, {cutter}" for name, (number, cutter) in self.cutters.items()]
        left = f"stock left where the cutter reaches: at most {self.left_mm * 1000:.6g} um"
        zero = f"zero: x = {x}, y = {y} of the lens, z = {z} above its bottom"
        return [zero, *uses, *([left] if "finishing" in self.cutters else [])]

    @classmethod
    def from_text(cls, lines: Iterable[str]) -> MillingSetup:
        """Read the setup from text that has the lines of ``to_text`` among others.

        Raises:
            InputError: the text does not say where zero is, or names no cutter.
        """
        zero, cutters, left = None, {}, float("inf")
        for line in map(str.strip, lines):
            if match := _ZERO.fullmatch(line):
                zero = float(match[1]), float(match[2]), float(match[3])
            elif match := _CUTTER.fullmatch(line):
                cutters[match[1]] = int(match[2]), Cutter.parse(match[3])
            elif match := _LEFT.fullmatch(line):
                left = float(match[1]) / 1000
        if zero is None or not cutters:
            raise InputError("it is not said where zero is or what cuts; keep what the exporter has written")
        return cls(cutters, zero, left)

    @property
    def tools(self) -> dict[int, Cutter]:
        """The cutters by their numbers."""
        return dict(self.cutters.values())


@dataclass(frozen=True)
class MillingProgram:
    """A program that a machine runs in one go.

    Attributes:
        moves: The moves, in the program's own frame, see ``MillingSetup.zero_mm``.
        setup: What must be known besides them.
    """

    moves: Moves
    setup: MillingSetup

    @cached_property
    def cuts(self) -> tuple[tuple[Cutter, FloatArray], ...]:
        """Each cutter and its straight moves at feed speed (K, 2, 3): from and to, mm, lens frame."""
        moves = self.moves.shifted(self.setup.zero_mm)
        return tuple((cutter, moves.cutting(number)) for number, cutter in self.setup.tools.items())

    def with_cutters(self, cutters: Mapping[int, Cutter]) -> MillingProgram:
        """The same moves with other cutters, by number; those that are not named stay."""
        used = {name: (number, cutters.get(number, old)) for name, (number, old) in self.setup.cutters.items()}
        return replace(self, setup=replace(self.setup, cutters=used))
