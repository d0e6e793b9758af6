"""Keeps the program alive and talking while it calls plugins: none ends the process, none is waited for in silence."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Timer

_PATIENCE_S = 5.0
"""Seconds after which the user is told what is being waited for."""

_really_exit = os._exit
_process: ContextVar[int | None] = ContextVar("_process", default=None)
"""The process that must not end now; None outside of plugins, and in threads that a plugin has started."""


@contextmanager
def without_exits() -> Iterator[None]:
    """Let ``os._exit`` raise SystemExit inside the ``with`` block: nothing could report such an end of the process.

    Processes that are forked inside the block may end themselves. Compiled code is out of reach.
    """
    before = _process.set(os.getpid())
    os._exit = _raise_or_exit  # type: ignore[assignment]  # it stays: outside of such blocks it does what it did
    try:
        yield
    finally:
        _process.reset(before)


@contextmanager
def told_when_slow(doing: str, plugin: str) -> Iterator[None]:
    """Say after some seconds, once, what the ``with`` block waits for.

    Args:
        doing: What is done, such as ``loading``.
        plugin: The name by which the user can disable it.
    """
    text = f"note: still {doing}; if it never ends: mlens --disable-plugin {plugin} ...\n"
    timer = Timer(_PATIENCE_S, lambda: sys.stderr.write(text))
    timer.daemon = True  # it must not keep a program alive that is done
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _raise_or_exit(status: int) -> None:
    if _process.get() == os.getpid():
        raise SystemExit(f"it called os._exit({status})")
    _really_exit(status)
