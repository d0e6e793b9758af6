"""Has functions called by the workers of a Dask cluster, and called again if workers or the scheduler die meanwhile."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from magiclens import InputError, StageError, raising

if TYPE_CHECKING:
    from distributed import Client, Future

_Given = TypeVar("_Given")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

TIMEOUT_S = 10.0
"""Longest time that a scheduler may take to answer, in seconds."""
PATIENCE_S = 5.0
"""Seconds without any worker after which the user is told how to start one, and between two looks for workers."""
_AHEAD = 2
"""So many items a worker has at a time: the one that it works on, and the next, whose data it gets meanwhile."""
_MOST_DEATHS = 4
"""So many workers may die while they have an item; it is tried once more then, alone."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""glibc's parameters of ``mallopt``."""
_LARGE_BYTES = 32 << 20
"""Arrays above this size get new memory: the highest such size that glibc comes to by itself."""

_one_at_a_time = threading.Lock()
"""Lock of the one item that a worker's process may work on: compiled code and matplotlib are not made for several."""


class Cluster:
    """A scheduler and its workers.

    What functions are given and what they return goes straight from this process to workers and back: the scheduler
    hears of sizes and places alone. What is lost with a worker or with the scheduler is sent again.
    """

    def __init__(self, address: str, wait_s: float, blocks: int | None = None):
        """Connect.

        Args:
            address: Of the scheduler.
            wait_s: Longest time without any worker, or without a scheduler that was there.
            blocks: Into how many blocks a loop is cut; by default as many as there are workers.

        Raises:
            OSError: No scheduler answers.
            ValueError: That is no address.
        """
        self._address, self._wait_s, self._blocks = address, wait_s, blocks
        self._sent: tuple[Any, Future[Any]] | None = None
        self._turn = threading.RLock()  # of the thread that talks to the scheduler
        self._connect()

    def close(self) -> None:
        """Disconnect."""
        self._client.close()

    @property
    def blocks(self) -> int:
        """See ``magiclens.Spreader``. Raises InputError if no worker comes."""
        with self._turn:
            while not self._blocks:
                try:
                    return len(self._workers())
                except OSError:
                    self._reconnect()
        return self._blocks

    def map(
        self, function: Callable[[_Given, _Item], _Result], given: _Given, items: Sequence[_Item]
    ) -> Iterator[_Result]:
        """See ``magiclens.Spreader``."""
        return raising(self.results(function, given, items))

    def results(
        self, function: Callable[[_Given, _Item], _Result], given: _Given, items: Iterable[_Item]
    ) -> Iterator[_Result | Exception]:
        """What a function returns or raises for every item, in their order.

        An item that several workers have died with may not have killed them. It is tried once more when all others are
        done, and given up if that kills another worker.

        Args:
            function: Of a module, so that workers find it.
            given: Its first argument, the same for all items. All workers get it, once in a row of calls with it.
            items: Its second arguments; one worker gets each.

        Raises:
            InputError: There was no worker, or no scheduler, for too long.
        """
        loop = _Loop(function, given, dict(enumerate(items)))
        for number in range(len(loop.left)):
            while number not in loop.found:
                with self._turn:
                    self._go_on(loop)
            yield loop.found.pop(number)

    def _go_on(self, loop: _Loop) -> None:
        """Submit what is due, and wait until something ends, at most for ``PATIENCE_S``."""
        from distributed import CancelledError, KilledWorker, wait

        loop.forget_all_but(self._client)  # another thread's loop may have given up a connection
        try:
            self._submit(loop)
            # or it would ask the client that the process has made last, whoever it is of
            with self._client.as_current(), suppress(TimeoutError, CancelledError):
                wait(list(loop.futures), PATIENCE_S, "FIRST_COMPLETED")
            for future in [future for future in loop.futures if future.done()]:
                number = loop.futures.pop(future)
                error = future.exception() if future.status == "error" else None
                if isinstance(error, KilledWorker):
                    loop.has_died(number, _MOST_DEATHS)
                elif error is not None:
                    loop.has_ended(number, error)
                else:
                    self._take(loop, number, future)
        except OSError:
            self._reconnect()

    def _take(self, loop: _Loop, number: int, future: Future[Any]) -> None:
        """Get the result of an item, or find out why there is none.

        Raises:
            OSError: The scheduler has died.
        """
        from distributed import CancelledError

        try:
            loop.has_ended(number, future.result(self._wait_s))
        except CancelledError:  # it was with a worker that has died, or known to a scheduler that has
            self._sent = None
            loop.placed.clear()
            self._require_scheduler()
            loop.has_died(number, 1)

    def _submit(self, loop: _Loop) -> None:
        """Give workers what is due, each as much as it may have at a time.

        Dask would give everything away at once, to where the data are, and move it when a worker has long been idle.
        """
        due = loop.due()
        if new := [number for number in due if number not in loop.placed]:
            items = self._placed([loop.left[number] for number in new])
            loop.placed.update(zip(new, items, strict=True))
        given, workers = self._everywhere(loop.given) if due else None, self._workers()
        has = Counter(loop.worker_of[number] for number in loop.futures.values())
        for number in due:
            worker = min(workers, key=lambda address: has[address])
            if has[worker] >= _AHEAD:
                return
            # not pure: Dask would work on equal items once
            future = self._client.submit(
                _call, loop.function, given, loop.placed.pop(number),
                pure=False, priority=-number, workers=[worker], allow_other_workers=True,
            )  # fmt: skip
            loop.futures[future], loop.worker_of[number] = number, worker
            has[worker] += 1

    def _everywhere(self, given: Any) -> Future[Any]:
        """An object on all workers. The last one stays there, as several loops in a row are about the same pictures."""
        if self._sent is None or self._sent[0] is not given:
            self._sent = given, self._placed([given], broadcast=True)[0]
        return self._sent[1]

    def _placed(self, data: list[Any], broadcast: bool = False) -> list[Future[Any]]:
        """Objects that have been sent to workers, each to one or to all of them.

        Raises:
            OSError: The scheduler has died.
        """
        began = time.monotonic()
        while True:
            self._workers()
            self._require_scheduler()
            try:
                placed: list[Future[Any]] = self._client.scatter(data, hash=False, broadcast=broadcast)
                return placed
            except (KeyError, ValueError):
                # a scheduler does not know the worker that has them, which has died or has not come back: a KeyError;
                # there is none left to copy them to: a ValueError
                if time.monotonic() - began > TIMEOUT_S:
                    raise
                time.sleep(0.1)

    def _connect(self) -> None:
        """Connect to the scheduler that there is. Raises OSError if none answers, ValueError if that is no address."""
        from distributed import Client

        # by default, the scheduler would pass on what is sent and found
        self._client = Client(self._address, timeout=TIMEOUT_S, direct_to_workers=True)
        self._scheduler = self._named()

    def _require_scheduler(self) -> None:
        """Make sure that the scheduler is the one that was connected to.

        Dask's client waits for one that is started again at the same address, and asks it as if nothing had happened.

        Raises:
            OSError: It has died; another one knows nothing of what was sent.
        """
        if self._named() != self._scheduler:
            raise ConnectionError

    def _named(self) -> object:
        """The name of the scheduler, which another one does not have.

        The client's own ``scheduler_info`` gives the name of a dead one as long as there is no other.

        Raises:
            OSError: The scheduler has died.
        """
        if (scheduler := self._client.scheduler) is None:
            raise ConnectionError
        return self._client.sync(scheduler.identity)["id"]

    def _reconnect(self) -> None:
        """Connect again.

        Raises:
            InputError: No scheduler has answered for too long.
        """
        self._sent = None
        began = time.monotonic()
        _say(f"{self._address} does not answer; what was under way begins again when there is a scheduler")
        while self._client.status == "connecting":  # it tries by itself for some seconds, and closes badly meanwhile
            time.sleep(0.1)
        self._client.close()
        while True:
            try:
                self._connect()
            except OSError:
                if time.monotonic() - began > self._wait_s:
                    raise InputError(
                        f"no scheduler at {self._address} for {self._wait_s:g} seconds", "wait_s"
                    ) from None
            else:
                return

    def _workers(self) -> list[str]:
        """The addresses of the workers. It waits for the first; after some seconds the user is told how to start one.

        Raises:
            InputError: None has come in ``wait_s`` seconds.
        """
        began, told = time.monotonic(), False
        while not (workers := list(self._client.nthreads())):
            waited = time.monotonic() - began
            advice = f"start one on any machine: dask worker {self._address} --nthreads 1"
            if waited > self._wait_s:
                raise InputError(f"no worker of {self._address} for {self._wait_s:g} seconds; {advice}", "wait_s")
            if waited > PATIENCE_S and not told:
                _say(f"{self._address} has no worker; {advice}")
                told = True
            time.sleep(0.1)
        return workers


@dataclass
class _Loop:
    """Items that workers go through.

    Attributes:
        function: What is called with ``given`` and each item.
        given: The same for all items.
        left: Items that have not ended, by number.
        found: Results of those that have, or exceptions, until they are asked for.
        placed: Data of items that wait for a worker.
        futures: Items that workers have.
        worker_of: Addresses of the workers that have got an item.
        deaths: How many workers have died with an item, or more than so many while it waited.
    """

    function: Callable[[Any, Any], Any]
    given: Any
    left: dict[int, Any]
    found: dict[int, Any] = field(default_factory=dict)
    placed: dict[int, Future[Any]] = field(default_factory=dict)
    futures: dict[Future[Any], int] = field(default_factory=dict)
    worker_of: dict[int, str] = field(default_factory=dict)
    deaths: Counter[int] = field(default_factory=Counter)

    def forget_all_but(self, client: Client) -> None:
        """Forget what a connection that is no more has sent."""
        self.placed = {number: data for number, data in self.placed.items() if data.client is client}
        self.futures = {future: number for future, number in self.futures.items() if future.client is client}

    def due(self) -> list[int]:
        """Numbers of the items to submit: all, but for doubtful ones, which wait until they can be alone."""
        submitted = set(self.futures.values())
        waiting = [number for number in self.left if number not in submitted]
        harmless = [number for number in waiting if self.deaths[number] < _MOST_DEATHS]
        return harmless or ([] if submitted else waiting[:1])

    def has_ended(self, number: int, outcome: Any) -> None:
        """An item has a result, or has raised an exception."""
        self.found[number] = outcome
        del self.left[number]

    def has_died(self, number: int, deaths: int) -> None:
        """So many workers have died with an item. One that was alone is given up."""
        if self.deaths[number] >= _MOST_DEATHS:
            self.has_ended(number, StageError("worker after worker died of this"))
        self.deaths[number] += deaths


def _call(function: Callable[[_Given, _Item], _Result], given: _Given, item: _Item) -> _Result:
    with _one_at_a_time:
        _keep_memory()
        return function(given, item)


@cache
def _keep_memory() -> None:
    """Let arrays use memory again that others have freed, as in any program.

    Dask's nanny has glibc give it back at once, so that every array of more than 128 kB begins with page faults: they
    would take a tenth of the matching, and more the more workers there are on a machine.
    """
    with suppress(OSError, TypeError, AttributeError):  # no library, or not glibc
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
        mallopt(_M_TRIM_THRESHOLD, 2 * _LARGE_BYTES)


def _say(text: str) -> None:
    print(f"note: {text}", file=sys.stderr, flush=True)
