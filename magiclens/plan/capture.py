"""Standard output belongs to the command: what plugins print goes to standard error, under their name.

Both ways out are closed: Python's ``sys.stdout``, and file descriptor 1, which compiled code and child processes use.
Text from the latter is kept in a file until the plugin is done.
"""

from __future__ import annotations

import ctypes
import io
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from threading import Lock
from typing import IO, Any


class Prints:
    """What somebody has printed: passed on line by line, each after their name; the first line is remembered."""

    def __init__(self, who: str):
        self.who = who
        self.first = ""
        self._begun = ""

    def add(self, text: str) -> None:
        """Pass on the lines that are complete."""
        *lines, self._begun = (self._begun + text).split("\n")
        for line in filter(str.strip, lines):
            self.first = self.first or line.strip()
            sys.stderr.write(f"{self.who}: {line}\n")  # at once, lest threads' lines mix
        sys.stderr.flush()

    def end(self) -> None:
        """Pass on the line that is not."""
        if self._begun:
            self.add("\n")


_speaking: ContextVar[Prints | None] = ContextVar("_speaking", default=None)
"""Who prints, in this thread."""


@contextmanager
def prints_of(who: str) -> Iterator[Prints]:
    """Inside, what is printed is ``who``'s. Threads may be inside at the same time."""
    prints, outer = Prints(who), _speaking.get()
    before = _speaking.set(prints)
    try:
        with _diverted(outer, prints):
            yield prints
    finally:
        prints.end()
        _speaking.reset(before)


class _Router(io.TextIOBase):
    """Stands for ``sys.stdout`` and gives each text to whom it belongs."""

    def write(self, text: str) -> int:
        """Threads that a plugin has started are nobody's: their text goes on unnamed."""
        prints = _speaking.get()
        if prints:
            prints.add(str(text))
        else:
            sys.stderr.write(str(text))
        return len(text)

    def writable(self) -> bool:
        """Yes."""
        return True

    def fileno(self) -> int:
        """For children that inherit it: descriptor 1, which is diverted too."""
        return 1


@dataclass
class _Diversion:
    """Standard output as it was, the descriptor that keeps it, and the file that stands in for it."""

    stdout: Any
    descriptor: int
    file: IO[bytes]


_lock = Lock()
_inside: list[_Diversion] = []
"""As often as somebody is inside; all are the same one."""


@contextmanager
def _diverted(outer: Prints | None, inner: Prints) -> Iterator[None]:
    """The first to enter diverts standard output, the last to leave restores it."""
    with _lock:
        if _inside and outer:
            _pass_on(outer)
        _inside.append(_inside[0] if _inside else _divert())
    try:
        yield
    finally:
        with _lock:
            _pass_on(inner)
            diversion = _inside.pop()
            if not _inside:
                _restore(diversion)


def _divert() -> _Diversion:
    _flush()
    diversion = _Diversion(sys.stdout, os.dup(1), tempfile.TemporaryFile())  # noqa: SIM115
    os.dup2(diversion.file.fileno(), 1)
    sys.stdout = _Router()
    return diversion


def _restore(diversion: _Diversion) -> None:
    sys.stdout = diversion.stdout
    os.dup2(diversion.descriptor, 1)
    os.close(diversion.descriptor)
    diversion.file.close()


def _pass_on(prints: Prints) -> None:
    """What has come by the descriptor."""
    _flush()
    file = _inside[0].file
    file.seek(0)
    text = file.read().decode(errors="replace")
    file.seek(0)
    file.truncate()
    prints.add(text)


def _flush() -> None:
    """Write out what Python and the C library still hold."""
    for stream in (sys.stdout, sys.__stdout__):
        with suppress(AttributeError, ValueError, OSError):
            stream.flush()  # type: ignore[union-attr]
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)
