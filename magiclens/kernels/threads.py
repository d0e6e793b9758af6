"""Runs a compiled loop in several threads.

numba can do that itself (``parallel=True``), but then takes several times as long to compile a kernel, which is most of
the time of a first run. A plain loop that is compiled with ``nogil`` runs in the threads of a Python pool.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

_PARTS_PER_THREAD = 8
"""Parts are more than threads, so that no thread waits long for one whose part takes more time."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class LoopPart(NamedTuple):
    """A part of a loop: the indices from ``first`` up to, without, ``end``."""

    first: int
    end: int


def in_threads(kernel: Callable[..., None], indices: int | range, *arguments: Any) -> None:
    """Call a kernel for consecutive parts of a loop, in as many threads as numba would use; this one is one of them.

    Args:
        kernel: Compiled with ``nogil``; takes a ``LoopPart`` and the arguments. For each index it must write to
            elements that no other index writes to, so that the result does not depend on how the loop is divided.
        indices: Of the loop: all below a number, or those of a range without gaps.
        arguments: The same for every part.
    """
    from numba import get_num_threads

    threads: int = get_num_threads()
    start, count = (0, indices) if isinstance(indices, int) else (indices.start, len(indices))
    parts = min(count, _PARTS_PER_THREAD * threads if threads > 1 else 1)
    edges = [start + k * count // max(parts, 1) for k in range(parts + 1)]
    left = iter([LoopPart(first, end) for first, end in pairwise(edges)])

    def work() -> None:
        for part in left:  # shared: each thread takes the next part that none has taken
            kernel(part, *arguments)

    helpers = [_pool(threads).submit(work) for _ in range(min(parts, threads) - 1)]
    try:
        work()
    finally:
        for _ in left:  # after an error nobody shall begin another part
            pass
        for helper in helpers:
            if not helper.cancel():  # one that has not begun yet, since others keep the pool busy, is not waited for
                helper.result()


def side_by_side(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    """What a Python function returns for some items, called in as many threads as numba would use; in their order.

    Args:
        work: Must not depend on the order of calls. Threads help where it releases the interpreter: in kernels, NumPy
            and SciPy.
        items: Its arguments.
    """
    return list(side_by_side_ahead(work, items))


def side_by_side_ahead(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """The same, one after the other: no more than a few results are ready before they are asked for.

    Args:
        work: See ``side_by_side``.
        items: Its arguments, which are asked for in this thread.
    """
    from numba import get_num_threads

    threads = get_num_threads()
    # threads of their own: those of kernels would wait for each other
    with ThreadPoolExecutor(threads, "side by side") as pool:
        ahead: deque[Future[_Result]] = deque()
        for item in items:
            ahead.append(pool.submit(work, item))
            if len(ahead) > 2 * threads:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads - 1, "kernel")
