"""The executor that sends tasks to the workers of a Dask cluster; if a worker dies, others do its tasks."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from pydantic import Field

from magiclens import Executor, InputError, StageError

if TYPE_CHECKING:
    from distributed import Client

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_TIMEOUT = "10s"
"""Longest time that a scheduler may take to answer."""

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

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result | Exception]:
        """See ``magiclens.Executor``. Dask gives the tasks of a worker that dies, and its results, to others."""
        with self.client() as client:
            yield from mapped(client, function, items)

    @contextmanager
    def client(self) -> Iterator[Client]:
        """A connection to the cluster; a cluster that was started for it ends with it. InputError if none answers."""
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
            yield client

    @contextmanager
    def _cluster(self) -> Iterator[Any]:
        """Worker processes on this machine.

        A worker that runs compiled code may not answer for minutes, so silence does not count as death. Dask's limit of
        memory is off: it would kill workers that the operating system can still serve.
        """
        import dask
        from distributed import LocalCluster

        with (
            dask.config.set({"distributed.scheduler.worker-ttl": None}),
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
    client: Client, function: Callable[[_Item], _Result], items: Iterable[_Item]
) -> Iterator[_Result | Exception]:
    """Call a function with every item on the workers of a cluster.

    Dask gives an item up after it was on several workers that died, even if another item has killed them. So an item
    that was given up is tried once more when all others are done.

    Args:
        client: The connection to the cluster.
        function: What to call.
        items: What to call it with.

    Returns:
        The results in the order of the items, as ``magiclens.Executor.map`` has them.
    """
    from distributed import KilledWorker, wait

    listed = list(items)
    shared = client.submit(_itself, function, pure=False)
    # not pure: Dask would work on equal items once
    futures = client.map(_apply, listed, function=shared, pure=False)
    for item, future in zip(listed, futures, strict=True):
        found = _settled(future)
        if isinstance(found, KilledWorker):
            wait(futures)
            found = _settled(client.submit(_apply, item, function=shared, pure=False))
        yield StageError("worker after worker died of this") if isinstance(found, KilledWorker) else found


def _settled(future: Any) -> Any:
    try:
        return future.result()
    except Exception as error:
        return error


def _itself(function: Callable[[_Item], _Result]) -> Callable[[_Item], _Result]:
    """The function itself: as the result of a task, it is sent to each worker once and not with every item."""
    return function


def _apply(item: _Item, function: Callable[[_Item], _Result]) -> _Result:
    with _one_at_a_time:
        return function(item)
