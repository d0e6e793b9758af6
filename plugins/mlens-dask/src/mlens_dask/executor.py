"""The executor: tasks go to the workers of a Dask cluster; what a worker that dies has left is done by others."""

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

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE = "10s"
"""How long a scheduler may take to answer."""

_ONE_AT_A_TIME = threading.Lock()
"""In each process of a worker: drawing and compiled code are not made for several tasks in one process."""


class Dask(Executor):
    """Tasks on the workers of a scheduler that is running, or on worker processes started for them alone."""

    type: ClassVar[str] = "dask"

    address: str | None = Field(
        None, min_length=1, description="scheduler to use, such as `tcp://10.0.0.5:8786`; none: workers of this machine"
    )
    workers: int = Field(2, ge=1, le=256, description="worker processes to start if there is no address")
    threads: int = Field(1, ge=1, le=256, description="threads of compiled code in each process that is started")

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result | Exception]:
        """Dask hands what a dead worker had, and results that it alone kept, to others."""
        with self.client() as client:
            yield from mapped(client, function, items)

    @contextmanager
    def client(self) -> Iterator[Client]:
        """A connection to the cluster; a cluster that was started for it ends with it."""
        from distributed import Client

        if self.address is None:
            with self._cluster() as cluster, Client(cluster) as client:
                yield client
            return
        try:
            client = Client(self.address, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise InputError(f"no scheduler answers at {self.address!r}: {error}", "address") from None
        with client:
            yield client

    @contextmanager
    def _cluster(self) -> Iterator[Any]:
        """Worker processes on this machine.

        Compiled code can keep a worker from answering for long, which is no sign of death; and memory is left to
        the operating system, as for any other program.
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
    client: Client, function: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[Result | Exception]:
    """See ``Dask.map``.

    Whoever waits on a worker is under suspicion when it dies, so an item that was given up is tried again, alone.
    """
    from distributed import KilledWorker, wait

    listed = list(items)
    shared = client.submit(_itself, function, pure=False)
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


def _itself(function: Callable[[Item], Result]) -> Callable[[Item], Result]:
    """Brings a function to the workers once, however many items there are."""
    return function


def _apply(item: Item, function: Callable[[Item], Result]) -> Result:
    with _ONE_AT_A_TIME:
        return function(item)
