"""Milling programs in G-code (RS274/NGC), as LinuxCNC and grbl take it; and programs read back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from magiclens.contract.errors import InputError
from magiclens.milling.exporter import Milling

if TYPE_CHECKING:
    from magiclens.milling.cutter import Cutter
    from magiclens.milling.moves import Moves
    from magiclens.milling.program import Program

MODES = "G17 G21 G90 G94 G40 G49 G80 G54"
ACCEPTED = {
    "G": {0, 1, 4, 17, 21, 40, 43, 49, 54, 64, 80, 90, 94},
    "M": {3, 5, 6, 30},
}
"""What ``parse_gcode`` understands: what programs here consist of. Anything else might move the tool elsewhere."""
WITH_P = {("G", "4"), ("G", "64")}

WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
COMMENT = re.compile(r"\(([^)]*)\)")


class Gcode(Milling):
    __doc__ = f"""G-code in millimetres, absolute, feed per minute. {Milling.__doc__}"""

    type: ClassVar[str] = "gcode"
    suffix: ClassVar[str] = ".ngc"
    step_mm: ClassVar[float] = 1e-4

    flavour: Literal["linuxcnc", "grbl"] = Field("linuxcnc", description="the controller that is to run it")

    @property
    def changes_cutters(self) -> bool:
        """LinuxCNC asks for another cutter; grbl cannot, so each of its programs has one."""
        return self.flavour == "linuxcnc"

    def write(self, program: Program, comments: list[str]) -> str:
        """The program as text, one move a line."""
        blend = f" G64 P{self.tolerance_mm:.4f}" if self.flavour == "linuxcnc" else ""
        lines = [f"({_plain(comment)})" for comment in comments]
        return "\n".join([*lines, MODES + blend, *self._body(program), "M5", "M30", ""])

    def _body(self, program: Program) -> Iterator[str]:
        tool, said, moves = 0, _Said(), program.moves
        steps = zip(moves.points.tolist(), moves.feed.tolist(), moves.tool.tolist(), strict=True)
        for (x, y, z), feed, number in steps:
            if number != tool:
                yield from self._call(number, program.facts.tools[number], first=tool == 0)
                tool, said = number, _Said()
                yield said.move(None, None, self.safe_height, 0.0)
            yield said.move(x, y, z, feed)

    def _call(self, number: int, cutter: Cutter, first: bool) -> Iterator[str]:
        """Load a cutter and start the spindle."""
        if not first:
            yield "M5"
        yield f"(cutter {number}: {_plain(str(cutter))})"
        yield from (f"T{number} M6", "G43") if self.flavour == "linuxcnc" else (f"T{number}",)
        yield f"S{self.spindle} M3"
        yield "G4 P2"


class _Said:
    """Leaves out the words that are still in force."""

    def __init__(self) -> None:
        self._said: dict[str, str] = {}

    def move(self, x: float | None, y: float | None, z: float, feed: float) -> str:
        """The line for a straight move; 0 feed is rapid, None is where it was."""
        words = {"G": "G1" if feed else "G0"}
        words |= {axis: f"{axis}{at + 0.0:.4f}" for axis, at in (("X", x), ("Y", y), ("Z", z)) if at is not None}
        if feed:
            words["F"] = f"F{feed:.5g}"
        new = [word.replace("-0.0000", "0.0000") for letter, word in words.items() if self._said.get(letter) != word]
        self._said |= words
        return " ".join(new)


def _plain(text: str) -> str:
    """What may stand in a comment."""
    return text.replace("(", "[").replace(")", "]")


def gcode_comments(text: str) -> list[str]:
    """Everything that stands in comments."""
    return [match[1] for match in COMMENT.finditer(text)]


def parse_gcode(text: str) -> Moves:
    """The moves of a program. Raises InputError at whatever is not understood, naming the line."""
    reader = _Reader()
    for number, line in enumerate(text.splitlines(), 1):
        try:
            reader.read(COMMENT.sub("", line).replace(" ", "").upper())
        except ValueError as error:
            raise InputError(f"{error} in {line.strip()!r}", f"line {number}") from None
    return reader.moves()


class _Reader:
    """The state of a machine that reads a program."""

    def __init__(self) -> None:
        self._at = {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self._rapid, self._feed, self._tool = True, 0.0, 0
        self._moves: list[tuple[float, float, float, float, int]] = []

    def read(self, block: str) -> None:
        """One line without spaces and comments."""
        words = WORD.findall(block)
        if "".join(letter + value for letter, value in words) != block:
            raise ValueError("not a line of words")
        parameter = not WITH_P.isdisjoint(words)
        moved = False
        for letter, value in words:
            if letter in self._at:
                self._at[letter] = float(value)
                moved = True
            else:
                self._word(letter, float(value), parameter)
        if moved:
            self._move()

    def _word(self, letter: str, value: float, parameter: bool) -> None:
        if letter in ACCEPTED:
            if value not in ACCEPTED[letter]:
                raise ValueError(f"{letter}{value:g} is not understood")
            if letter == "G" and value in (0, 1):
                self._rapid = value == 0
        elif letter == "F":
            self._feed = value
        elif letter == "T":
            self._tool = int(value)
        elif not (letter == "S" or (letter == "P" and parameter)):
            raise ValueError(f"{letter} is not understood")

    def _move(self) -> None:
        if not self._rapid and self._feed <= 0:
            raise ValueError("a feed move before any feed speed")
        feed = 0.0 if self._rapid else self._feed
        self._moves.append((self._at["X"], self._at["Y"], self._at["Z"], feed, self._tool))

    def moves(self) -> Moves:
        """Everything that was read."""
        import numpy as np

        from magiclens.milling.moves import Moves

        table = np.array(self._moves, float).reshape(-1, 5)
        return Moves(table[:, :3], table[:, 3], table[:, 4].astype(np.int64)).without_pauses()
