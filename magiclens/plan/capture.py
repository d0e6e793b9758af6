"""Captures what plugins print, so that standard output holds nothing but what a command prints itself.

Plugins' output goes to standard error, each line with the name of its plugin. There are two ways to print, and both
are captured: Python's ``sys.stdout``, and file descriptor 1, to which compiled code and child processes write. What
comes by the descriptor is kept in a file until the plugin is done: a pipe that nobody empties would stop the plugin
when it is full.
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


class CapturedOutput:
    """Output of one plugin, which is passed on to standard error line by line.

    Attributes:
        owner: The name that is put before every line.
        first_line: The first line that is not blank; empty while there is none.
    """

    def __init__(self, owner: str):
        self.owner = owner
        self.first_line = ""
        self._unfinished = ""

    def add(self, text: str) -> None:
        """Take in some output, and pass on the lines that are complete."""
        *lines, self._unfinished = (self._unfinished + text).split("\n")
        for line in filter(str.strip, lines):
            self.first_line = self.first_line or line.strip()
            # one write per line, so that lines of several threads do not mix
            sys.stderr.write(f"{self.owner}: {line}\n")
        sys.stderr.flush()

    def end(self) -> None:
        """Pass on the last line, which may have no line break."""
        if self._unfinished:
            self.add("\n")


_capturing: ContextVar[CapturedOutput | None] = ContextVar("_capturing", default=None)
"""Where output of the current thread goes."""


@contextmanager
def captured_output(owner: str) -> Iterator[CapturedOutput]:
    """Capture what is printed inside the ``with`` block.

    Several threads may be inside at the same time, and blocks may be nested; output is the innermost owner's.

    Args:
        owner: The name that is put before every line, such as ``exporter off (mlens-off 0.1.0)``.
    """
    captured, outer = CapturedOutput(owner), _capturing.get()
    before = _capturing.set(captured)
    try:
        with _diverted(outer, captured):
            yield captured
    finally:
        captured.end()
        _capturing.reset(before)


class _Router(io.TextIOBase):
    """Replaces ``sys.stdout`` and adds each text to the output of the thread that writes it."""

    def write(self, text: str) -> int:
        """Pass on one text; a thread that a plugin has started has no owner, so its text stays without a name."""
        captured = _capturing.get()
        if captured:
            captured.add(str(text))
        else:
            sys.stderr.write(str(text))
        return len(text)

    def writable(self) -> bool:
        """Say that texts can be written."""
        return True

    def fileno(self) -> int:
        """The descriptor that child processes inherit; it is diverted too."""
        return 1


@dataclass
class _Diversion:
    """How standard output is diverted.

    Attributes:
        stdout: ``sys.stdout`` as it was.
        descriptor: A copy of file descriptor 1 as it was.
        file: The file that descriptor 1 writes to instead.
    """

    stdout: Any
    descriptor: int
    file: IO[bytes]


_lock = Lock()
"""Held while blocks are entered and left, since several threads share the one standard output."""
_inside: list[_Diversion] = []
"""One item for each block that is open, all of them the same diversion: there is one standard output to divert."""


@contextmanager
def _diverted(outer: CapturedOutput | None, inner: CapturedOutput) -> Iterator[None]:
    """Divert standard output when the first block is entered, and restore it when the last one is left."""
    with _lock:
        # what was printed until here belongs to the outer block
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


def _pass_on(captured: CapturedOutput) -> None:
    """Add to an owner's output what descriptor 1 has received since the last call."""
    _flush()
    file = _inside[0].file
    # descriptor 1 is a copy of the file's and shares its position: what is printed next begins at 0 again
    file.seek(0)
    text = file.read().decode(errors="replace")
    file.seek(0)
    file.truncate()
    captured.add(text)


def _flush() -> None:
    """Write out what Python and the C library still hold in their buffers."""
    for stream in (sys.stdout, sys.__stdout__):
        with suppress(AttributeError, ValueError, OSError):
            stream.flush()  # type: ignore[union-attr]
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)
