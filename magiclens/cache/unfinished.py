"""Keeps what a stage has done so far, while it works: a run that is killed then loses seconds instead of minutes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magiclens.cache.store import Cache, Damaged, new_entry
from magiclens.cache.values import digest_of

PAUSE_S = 10.0
"""Seconds of work after which it is kept, and so what a kill costs at most, beside the item that was worked on."""
_AT_THE_END = 0.25
"""The same at the end of a loop, relative to it: what was kept in the loop may be older than that."""
WORK_PER_WRITING = 100
"""A pause is at least so many times as long as writing took."""


class Unfinished:
    """What a stage has done so far: for each loop that it has gone through, what the loop changes.

    It is kept under the key of the stage's result and the number of the loop. Equal keys are of equal inputs, so the
    states of several runs fit together.
    """

    def __init__(self, cache: Cache, key: str, step: str, say: Callable[[str], None]):
        """``key`` and ``step`` are those of the result; ``say`` is told in one line that a loop goes on."""
        self._cache, self._key, self._step, self._say = cache, key, step, say
        self._loops, self._kept = 0, set[str]()
        self._since, self._pause = perf_counter(), PAUSE_S

    def loop(self, count: int, state: Sequence[NDArray[Any]]) -> Iterator[int]:
        """Go through the numbers below a count, see ``kernels.resuming.Loop``."""
        kinds = [[array.dtype.str, *array.shape] for array in state]
        made_of = {
            "step": f"{self._step}, unfinished", "key": self._key, "loop": self._loops, "count": count, "state": kinds,
        }  # fmt: skip
        self._loops += 1
        first = self._restored(digest_of(made_of), count, state)
        for done in range(first + 1, count + 1):
            yield done - 1
            if perf_counter() - self._since >= self._pause * (_AT_THE_END if done == count else 1):
                self._keep(made_of, done, state)

    def forget(self) -> None:
        """Remove all of it: the stage has finished, and its result is kept."""
        for key in self._kept:
            self._cache.remove(key)

    def _restored(self, key: str, count: int, state: Sequence[NDArray[Any]]) -> int:
        """Fill the state with what was kept of it; how many items that stands for."""
        entry = self._cache.find(key)
        if entry is None:
            return 0
        self._kept.add(key)
        try:
            arrays = self._cache.value(entry)
        except Damaged:
            return 0
        for array, kept in zip(state, arrays, strict=True):
            array[...] = kept
        done: int = entry.facts
        self._say(f"{self._step} goes on where a run was ended: {done} of {count} parts are kept")
        return done

    def _keep(self, made_of: dict[str, Any], done: int, state: Sequence[NDArray[Any]]) -> None:
        began = perf_counter()
        entry = new_entry(made_of["step"], made_of, began - self._since, done)
        self._cache.keep(entry, [np.asarray(array) for array in state])
        self._kept.add(entry.key)
        self._since = perf_counter()
        self._pause = max(PAUSE_S, WORK_PER_WRITING * (self._since - began))
