"""Long loops of stages: a run that is killed in one goes on in it, instead of beginning the stage again.

A stage that works for minutes may go through its loop by ``resumable``, which changes nothing else for it. Where
nothing is kept, as without a cache, the loop is an ordinary one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from numpy.typing import NDArray

_T = TypeVar("_T")

Loop = Callable[[int, Sequence[NDArray[Any]]], Iterator[int]]
"""Goes through the numbers below the first argument, those left out that were done before a run was killed. The arrays
are all that the loop changes; they are filled with what they held after these."""

MOST_BLOCKS, LEAST_PER_BLOCK = 16, 64
"""How many blocks a loop over facets is divided into, and how many facets are in one at least, so that threads do not
wait for each other at the end of each."""

_loop: ContextVar[Loop | None] = ContextVar("_loop", default=None)
"""How loops of the stage that works in this thread are gone through."""


def resumable(items: Sequence[_T], *state: NDArray[Any]) -> Iterator[_T]:
    """Go through items; after a kill, those are left out that were done before.

    What a run may rely on: every time that a stage is called with equal inputs, it goes through the same loops in the
    same order, whatever the number of threads.

    Args:
        items: What the loop is about.
        state: All that the loop changes: arrays that it writes to in place. What follows from inputs alone, as random
            numbers do that are drawn before the loop, need not be among them.

    Returns:
        The items that are left, in their order. Before the first of them, the state is what it was when it was kept.
    """
    loop = _loop.get()
    return iter(items) if loop is None else (items[k] for k in loop(len(items), state))


def blocks(count: int) -> list[range]:
    """Indices below a count, such as those of facets, in blocks; their number does not depend on that of threads."""
    parts = max(1, min(MOST_BLOCKS, count // LEAST_PER_BLOCK))
    return [range(k * count // parts, (k + 1) * count // parts) for k in range(parts)]


@contextmanager
def going_through_loops_by(loop: Loop | None) -> Iterator[None]:
    """Let ``resumable`` go through loops in this way while a stage works; None for ordinary ones."""
    before = _loop.set(loop)
    try:
        yield
    finally:
        _loop.reset(before)
