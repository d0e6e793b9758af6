"""SIGTERM ends the process as an exception does, so that unfinished folders are removed."""

from __future__ import annotations

import signal
from typing import Any, NoReturn

from magiclens.contract.errors import Terminated

_CODE = 128 + signal.SIGTERM
"""The exit code, as shells count it."""
_asked: list[int] = []
"""The signals that have come."""


def end_on_sigterm() -> None:
    """From now on SIGTERM raises Terminated, at once and again at the next ``raise_if_terminated``."""
    _asked.clear()
    signal.signal(signal.SIGTERM, _terminated)


def raise_if_terminated() -> None:
    """Raise Terminated if SIGTERM has come: some libraries catch every exception while they are imported."""
    if _asked:
        raise Terminated(_CODE)


def _terminated(number: int, _: Any) -> NoReturn:
    _asked.append(number)
    raise Terminated(_CODE)
