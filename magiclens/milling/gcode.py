"""Milling programs in G-code (RS274/NGC) as LinuxCNC and grbl take it, written and read back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from magiclens.contract.errors import InputError
from magiclens.milling.line_milling import LineMilling
from magiclens.milling.program import MillingSetup

if TYPE_CHECKING:
    from magiclens.milling.cutter import Cutter
    from magiclens.milling.program import MillingProgram
    from magiclens.milling.toolpath import Moves

_MODES = "G17 G21 G90 G94 G40 G49 G80 G54"
"""Plane xy, millimetres, absolute, feed per minute, no offsets, no canned cycle, first coordinate system."""
_ACCEPTED = {
    "G": {0, 1, 4, 17, 21, 40, 43, 49, 54, 64, 80, 90, 94},
    "M": {3, 5, 6, 30},
}
"""Codes that ``parse_gcode`` understands: those that are written here. Any other might move the tool elsewhere."""
_WITH_P = {("G", "4"), ("G", "64")}
"""Words that take a parameter P."""

_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
"""A word: a letter and a number."""
_COMMENT = re.compile(r"\(([^)]*)\)")
"""A comment between brackets."""


class Gcode(LineMilling):  # noqa: D101 - the docstring goes on with that of the base
    __doc__ = f"""G-code in millimetres, absolute, feed per minute. {LineMilling.__doc__}"""

    type: ClassVar[str] = "gcode"
    suffix: ClassVar[str] = ".ngc"
    step_mm: ClassVar[float] = 1e-4

    flavour: Literal["linuxcnc", "grbl"] = Field("linuxcnc", description="the controller that is to run it")

    @property
    def changes_cutters(self) -> bool:
        """LinuxCNC asks for another cutter; grbl cannot, so each of its programs has one."""
        return self.flavour == "linuxcnc"

    def write(self, program: MillingProgram, comments: list[str]) -> str:
        """The program as text, one move a line."""
        # LinuxCNC rounds corners by at most P, so that it need not stop at each; grbl does not know G64
        blend = f" G64 P{self.tolerance_mm:.4f}" if self.flavour == "linuxcnc" else ""
        lines = [f"({_plain(comment)})" for comment in comments]
        return "\n".join([*lines, _MODES + blend, *self._body(program), "M5", "M30", ""])

    def parse(self, text: str, setup: MillingSetup) -> Moves:
        """The moves; programs name their cutters themselves. Raises InputError, see ``parse_gcode``."""
        return parse_gcode(text)

    def read_setup(self, path: Path, text: str) -> MillingSetup:
        """The setup as the comments say, so that a program needs no other file."""
        return MillingSetup.from_text(match[1] for match in _COMMENT.finditer(text))

    def _body(self, program: MillingProgram) -> Iterator[str]:
        tool, words, moves = 0, _ModalWords(), program.moves
        steps = zip(moves.points.tolist(), moves.feed.tolist(), moves.tool.tolist(), strict=True)
        for (x, y, z), feed, number in steps:
            if number != tool:
                yield from self._call(number, program.setup.tools[number], first=tool == 0)
                tool, words = number, _ModalWords()
                # up first: where a machine leaves the cutter after a change is not known
                yield words.move(None, None, self.safe_height, 0.0)
            yield words.move(x, y, z, feed)

    def _call(self, number: int, cutter: Cutter, first: bool) -> Iterator[str]:
        """Load a cutter and start the spindle."""
        if not first:
            yield "M5"
        yield f"(cutter {number}: {_plain(str(cutter))})"
        yield from (f"T{number} M6", "G43") if self.flavour == "linuxcnc" else (f"T{number}",)
        yield f"S{self.spindle} M3"
        yield "G4 P2"  # wait 2 s, until the spindle is up to speed


class _ModalWords:
    """Writes moves, and leaves out the words of G-code that are still in force from earlier lines."""

    def __init__(self) -> None:
        self._in_force: dict[str, str] = {}

    def move(self, x: float | None, y: float | None, z: float, feed: float) -> str:
        """The line for a straight move; 0 feed is rapid, None is where it was."""
        words = {"G": "G1" if feed else "G0"}
        words |= {axis: f"{axis}{at + 0.0:.4f}" for axis, at in (("X", x), ("Y", y), ("Z", z)) if at is not None}
        if feed:
            words["F"] = f"F{feed:.5g}"
        in_force = self._in_force
        new = [word.replace("-0.0000", "0.0000") for letter, word in words.items() if in_force.get(letter) != word]
        self._in_force = in_force | words
        return " ".join(new)


def _plain(text: str) -> str:
    """The text as a comment may have it: comments cannot be nested."""
    return text.replace("(", "[").replace(")", "]")


def parse_gcode(text: str) -> Moves:
    """The moves of a program. Raises InputError naming the first line that is not understood."""
    reader = _Reader()
    for number, line in enumerate(text.splitlines(), 1):
        try:
            reader.read(_COMMENT.sub("", line).replace(" ", "").upper())
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
        words = _WORD.findall(block)
        if "".join(letter + value for letter, value in words) != block:
            raise ValueError("not a line of words")
        parameter = not _WITH_P.isdisjoint(words)
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
        if letter in _ACCEPTED:
            if value not in _ACCEPTED[letter]:
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
        """All moves that were read."""
        import numpy as np

        from magiclens.milling.toolpath import Moves

        table = np.array(self._moves, float).reshape(-1, 5)
        return Moves(table[:, :3], table[:, 3], table[:, 4].astype(np.int64)).without_pauses()
