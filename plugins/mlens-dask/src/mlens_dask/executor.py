"""The executor that sends tasks to the workers of a Dask cluster; if a worker dies, others do its tasks."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from pydantic import Field

from magiclens import Executor, InputError, StageError

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_TIMEOUT = "10s"
"""Longest time that a scheduler may take to answer."""
_NEVER = "3650d"
"""Longer than any list of tasks takes."""
PATIENCE_S = 5.0
"""Seconds without any worker after which the user is told how to start one, and between two looks for workers."""

_one_at_a_time = threading.Lock()
"""Lock of the one task that a worker's process may work on: compiled code and matplotlib are not made for several."""


class Dask(Executor):
    """Works on tasks with the workers of a running scheduler, or with worker processes that are started for them."""

    type: ClassVar[str] = "dask"

    address: str | None = Field(
        None, min_length=1, description="scheduler to use, such as `tcp://10.0.0.5:8786`; none: workers of this machine"
    )
    workers: int = Field(2, ge=1, le=256, description="worker processes to start if there is no address")
    threads: int = Field(1, ge=1, le=256, description="threads of compiled code in each process that is started")
    wait_s: float = Field(600, gt=0, le=1e7, description="longest time without any worker, in seconds")

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result | Exception]:
        """See ``magiclens.Executor``. Dask gives the tasks of a worker that dies, and its results, to others."""
        with self.client() as client:
            yield from mapped(client, function, items, self.wait_s)

    @contextmanager
    def client(self) -> Iterator[Client]:
        """A connection to a cluster that has a worker; a cluster that was started for it ends with it.

        Raises:
            InputError: No scheduler answers, or no worker comes.
        """
        from distributed import Client

        if self.address is None:
            with self._cluster() as cluster, Client(cluster) as client:
                yield client
            return
        try:
            client = Client(self.address, timeout=_TIMEOUT)
        except (OSError, ValueError) as error:
            raise InputError(f"no scheduler answers at {self.address!r}: {error}", "address") from None
        with client:
            wait_for_a_worker(client, self.wait_s)
            yield client

    @contextmanager
    def _cluster(self) -> Iterator[Any]:
        """Worker processes on this machine.

        A worker that runs compiled code may not answer for minutes, so silence does not count as death. Dask's limit of
        memory is off: it would kill workers that the operating system can still serve. So is its closing of lost
        workers: it looks once, seconds after a worker died, and would close a nanny whose next worker is starting.
        """
        import dask
        from distributed import LocalCluster

        with (
            dask.config.set(
                {"distributed.scheduler.worker-ttl": None, "distributed.deploy.lost-worker-timeout": _NEVER}
            ),
            LocalCluster(
                n_workers=self.workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
                env={"NUMBA_NUM_THREADS": self.threads},
            ) as cluster,
        ):
            yield cluster


def mapped(
    client: Client, function: Callable[[_Item], _Result], items: Iterable[_Item], wait_s: float
) -> Iterator[_Result | Exception]:
    """Call a function with every item on the workers of a cluster.

    Dask gives an item up after it was on several workers that died, even if another item has killed them. So an item
    that was given up is tried once more when all others are done.

    Args:
        client: The connection to the cluster.
        function: What to call.
        items: What to call it with.
        wait_s: Longest time without any worker.

    Returns:
        The results in the order of the items, as ``magiclens.Executor.map`` has them.

    Raises:
        InputError: There was no worker for too long.
    """
    from distributed import KilledWorker

    listed = list(items)
    shared = client.submit(_itself, function, pure=False)
    # not pure: Dask would work on equal items once
    futures = client.map(_apply, listed, function=shared, pure=False)
    for item, future in zip(listed, futures, strict=True):
        found = _settled(client, future, wait_s)
        if isinstance(found, KilledWorker):
            for other in futures:
                _wait_for(client, other, wait_s)
            found = _settled(client, client.submit(_apply, item, function=shared, pure=False), wait_s)
        yield StageError("worker after worker died of this") if isinstance(found, KilledWorker) else found


def wait_for_a_worker(client: Client, wait_s: float) -> None:
    """Wait until a cluster has a worker; after some seconds the user is told how to start one.

    Raises:
        InputError: None has come in ``wait_s`` seconds.
    """
    began, told = time.monotonic(), False
    while not client.nthreads():
        waited, scheduler = time.monotonic() - began, client.scheduler_info()["address"]
        advice = f"start one on any machine: dask worker {scheduler} --nthreads 1"
        if waited > wait_s:
            raise InputError(f"no worker of {scheduler} for {wait_s:g} seconds; {advice}", "wait_s")
        if waited > PATIENCE_S and not told:
            print(f"note: {scheduler} has no worker; {advice}", file=sys.stderr, flush=True)
            told = True
        time.sleep(0.1)


def _settled(client: Client, future: Any, wait_s: float) -> Any:
    _wait_for(client, future, wait_s)
    try:
        return future.result()
    except Exception as error:
        return error


def _wait_for(client: Client, future: Any, wait_s: float) -> None:
    """Wait until an item is done, as long as there are workers who could do it."""
    from distributed import wait

    while not future.done():
        wait_for_a_worker(client, wait_s)
        with suppress(TimeoutError):
            wait(future, PATIENCE_S)


def _itself(function: Callable[[_Item], _Result]) -> Callable[[_Item], _Result]:
    """The function itself: as the result of a task, it is sent to each worker once and not with every item."""
    return function


def _apply(item: _Item, function: Callable[[_Item], _Result]) -> _Result:
    with _one_at_a_time:
        return function(item)
