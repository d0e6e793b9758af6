"""Runs a compiled loop in several threads.

numba can do that itself (``parallel=True``), but then takes several times as long to compile a kernel, which is most of
the time of a first run. A plain loop that is compiled with ``nogil`` runs in the threads of a Python pool.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

_PARTS_PER_THREAD = 8
"""Parts are more than threads, so that no thread waits long for one whose part takes more time."""


class LoopPart(NamedTuple):
    """A part of a loop: the indices from ``first`` up to, without, ``end``."""

    first: int
    end: int


def in_threads(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Call a kernel for consecutive parts of a loop, in as many threads as numba would use.

    Args:
        kernel: Compiled with ``nogil``; takes a ``LoopPart`` and the arguments. For each index it must write to
            elements that no other index writes to, so that the result does not depend on how the loop is divided.
        count: Number of indices of the loop.
        arguments: The same for every part.
    """
    from numba import get_num_threads

    threads: int = get_num_threads()
    parts = min(count, _PARTS_PER_THREAD * threads if threads > 1 else 1)
    edges = [k * count // max(parts, 1) for k in range(parts + 1)]
    calls = [LoopPart(first, end) for first, end in pairwise(edges)]
    if len(calls) < 2:
        for part in calls:
            kernel(part, *arguments)
    else:
        list(_pool(threads).map(lambda part: kernel(part, *arguments), calls))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "kernel")
