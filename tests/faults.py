"""Runs a command in a child process in which the n-th change of a file fails, or at which a signal comes.

Changes are counted where Python announces them to audit hooks: files that are opened for writing, names that change,
folders that are made and removed. So nothing in the package knows of the tests, and nothing has to be timed.
"""

from __future__ import annotations

import errno
import os
import re
import resource
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from magiclens.cli import app
from magiclens.plan.registry import Registry
from magiclens.running import replacing
from magiclens.running.observers import Observer

_CHANGES = ("os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.truncate", "tempfile.mkdtemp")
_CHANGE = "<change>\n"
_PART = re.compile(r"<part (.*)>\n")
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass(frozen=True)
class Ended:
    """How a command has ended.

    Attributes:
        code: Its exit code; minus the signal that has killed it.
        errors: What it has written to standard error.
        changes: How many changes there were; beginnings and ends of parts count as well.
        parts: Names of the parts of a run that have begun.
    """

    code: int
    errors: str
    changes: int
    parts: tuple[str, ...]


def no_space() -> None:
    """Fail as a full disk does, which does not say which file it had no room for."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def signalled(number: int) -> Callable[[], None]:
    """A fault that sends a signal to the process that it happens in."""
    return lambda: os.kill(os.getpid(), number)


def command(
    arguments: list[str],
    registry: Registry,
    root: Path,
    at: int | None = None,
    fault: Callable[[], None] = no_space,
    swaps: bool = True,
    largest_bytes: int | None = None,
) -> Ended:
    """Run a command of ``mlens`` in a child process.

    Args:
        arguments: The command's.
        registry: What is installed.
        root: The folder below which changes count.
        at: The number of the change before which the fault happens, from 1; None for no fault.
        fault: What happens.
        swaps: Whether the system can exchange two names at one moment.
        largest_bytes: How large files may become.
    """
    notes, writing = os.pipe()
    child = os.fork()
    if child == 0:
        code = 99
        try:
            _become(writing, largest_bytes)
            _count_changes(root, at, fault, swaps)
            Registry.load = classmethod(lambda *_: registry)  # type: ignore[assignment, method-assign]
            app(arguments)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else code
        except BaseException as error:
            os.write(2, f"Traceback: {error!r}\n".encode())
        os._exit(code)
    os.close(writing)
    with open(notes, encoding="utf-8") as stream:
        text = stream.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return Ended(code, _PART.sub("", text.replace(_CHANGE, "")), text.count(_CHANGE), (*_PART.findall(text),))


def _become(standard_error: int, largest_bytes: int | None) -> None:
    """Turn a copy of the tests' process into one that runs a command."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.dup2(standard_error, 2)
    sys.stderr = open(2, "w", encoding="utf-8", buffering=1, closefd=False)  # noqa: SIM115
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    if largest_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest_bytes, largest_bytes))


def _count_changes(root: Path, at: int | None, fault: Callable[[], None], swaps: bool) -> None:
    """Count what changes files, and the beginnings and ends of parts of a run; let the fault happen."""
    count = 0

    def change() -> None:
        nonlocal count
        count += 1
        os.write(2, _CHANGE.encode())
        if count == at:
            fault()

    def announced(event: str, arguments: tuple[Any, ...]) -> None:
        writes = event in _CHANGES or (event == "open" and bool(arguments[2] & _WRITING))
        if writes and str(root) in str(arguments[0]):
            change()

    def started(_: Observer, name: str, facets: int) -> None:
        os.write(2, f"<part {name}>\n".encode())
        change()

    def then(work: Callable[..., Any], *arguments: Any) -> Any:
        change()
        return work(*arguments)

    def exchange(one: Path, other: Path) -> bool:
        done = swaps and then(really_exchange, one, other)
        change()
        return done

    sys.addaudithook(announced)
    really_exchange, replacing._exchange = replacing._exchange, exchange
    os.fsync = partial(then, os.fsync)
    Observer.started = started  # type: ignore[method-assign]
    Observer.finished = lambda *_: change()  # type: ignore[method-assign]
