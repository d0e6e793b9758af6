"""Loops of stages whose items do not depend on each other, such as blocks of facets: done here, or by other machines.

A stage that works for minutes may go through such a loop by ``spread``. Who does the items is no business of the stage:
an executor may send them to a cluster, and where there is none, it is an ordinary loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray

from magiclens.kernels.resuming import resumable

_Given = TypeVar("_Given")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Spreader(Protocol):
    """Has the items of a loop done elsewhere; an executor has one, see ``Executor.spreader``.

    Several threads may ask it at a time.
    """

    @property
    def blocks(self) -> int:
        """Into how many blocks a loop should be cut, if each costs something: as many as can be done at a time."""

    def map(
        self, function: Callable[[_Given, _Item], _Result], given: _Given, items: Sequence[_Item]
    ) -> Iterator[_Result]:
        """Call a function with every item, see ``spread``; the first exception is raised."""


_spreader: ContextVar[Spreader | None] = ContextVar("_spreader", default=None)
"""Who does the loops of the stage that works in this thread."""


def spread(
    function: Callable[[_Given, _Item], _Result], given: _Given, items: Sequence[_Item], *state: NDArray[Any]
) -> Iterator[tuple[int, _Result]]:
    """Call a function with every item: here, one after the other, or wherever the executor of this run has it done.

    Args:
        function: Of a module, so that other machines find it. What it returns depends on its arguments alone, and can
            be pickled like them.
        given: Its first argument, the same for all items, such as pictures. It is sent once to each machine, also if
            several loops are given it; so it must not be changed.
        items: Its second arguments, such as blocks of facets with their heights.
        state: All that the body of the loop changes, see ``resumable``: a run that was killed goes on in the loop. None
            if the loop shall begin again then.

    Yields:
        For each item that is left to do, its number and what the function returns, in the order of the items.
    """
    numbers = resumable(range(len(items)), *state) if state else iter(range(len(items)))
    first = next(numbers, None)
    if first is None:
        return
    spreader, left = _spreader.get(), items[first:]
    results = spreader.map(function, given, left) if spreader else (function(given, item) for item in left)
    yield first, next(results)
    for number in numbers:
        yield number, next(results)


def is_spread() -> bool:
    """Whether others do what this thread's stage spreads, so that it cannot tell how far an item is."""
    return _spreader.get() is not None


def shares(count: int, finer: int = 1, most: int | None = None) -> list[range]:
    """Indices below a count, such as those of rows of facets, in blocks to be ``spread``.

    Results must not depend on how they are divided.

    Args:
        count: How many indices there are.
        finer: The smallest blocks are so many times smaller than an even share. They come last, so that nobody waits
            long for the slowest, and the first ones are larger, so that they are few. By default all shares are even.
        most: How many indices are in a block at most; any number by default.

    Returns:
        Blocks in ascending order, none of them empty. Without a spreader they are even: one, but for ``most``.
    """
    spreader, blocks, left = _spreader.get(), list[range](), count
    at_a_time, finer = (spreader.blocks, finer) if spreader else (1, 1)
    while left > 0:
        # half of an even share of what is left, while that is more than a smallest block
        parts = max(min(2 * at_a_time, -(-left * finer * at_a_time // count)), -(-left // (most or count)))
        size = -(-left // parts)
        blocks.append(range(count - left, count - left + size))
        left -= size
    return blocks


@contextmanager
def spreading_by(spreader: Spreader | None) -> Iterator[None]:
    """Let a spreader do what stages ``spread`` in this thread; None: it is done here."""
    before = _spreader.set(spreader)
    try:
        yield
    finally:
        _spreader.reset(before)
