"""The executor that sends tasks and parts of lenses to the workers of a Dask cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from typing import ClassVar, TypeVar

from pydantic import Field

from magiclens import Executor, InputError
from mlens_dask.cluster import Cluster

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_NEVER = "3650d"
"""Longer than any list of tasks takes."""


class Dask(Executor):
    """Works on tasks with the workers of a running scheduler, or with worker processes that are started for them."""

    type: ClassVar[str] = "dask"

    address: str | None = Field(
        None, min_length=1, description="scheduler to use, such as `tcp://10.0.0.5:8786`; none: workers of this machine"
    )
    workers: int = Field(2, ge=1, le=256, description="worker processes to start if there is no address")
    threads: int = Field(1, ge=1, le=256, description="threads of compiled code in each process that is started")
    wait_s: float = Field(600, gt=0, le=1e7, description="longest time without any worker or scheduler, in seconds")

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result | Exception]:
        """See ``magiclens.Executor``. Items of a worker that dies are given to others."""
        with self.cluster() as cluster:
            yield from cluster.results(_call, function, items)

    @contextmanager
    def spreader(self) -> Iterator[Cluster]:
        """See ``magiclens.Executor``."""
        with self.cluster() as cluster:
            yield cluster

    @contextmanager
    def cluster(self, blocks: int | None = None) -> Iterator[Cluster]:
        """A cluster that has a worker; one that was started for it ends with it.

        Args:
            blocks: Into how many blocks it wants loops cut; by default as many as there are workers.

        Raises:
            InputError: No scheduler answers, or no worker comes.
        """
        with self._scheduler() as address:
            try:
                cluster = Cluster(address, self.wait_s, blocks)
            except (OSError, ValueError) as error:
                raise InputError(f"no scheduler answers at {address!r}: {error}", "address") from None
            with closing(cluster):
                yield cluster

    @contextmanager
    def _scheduler(self) -> Iterator[str]:
        """The address of the scheduler; one of this machine, with worker processes, if none was given.

        A worker that runs compiled code may not answer for minutes, so silence does not count as death. Dask's limit of
        memory is off: it would kill workers that the operating system can still serve. So is its closing of lost
        workers: it looks once, seconds after a worker died, and would close a nanny whose next worker is starting. And
        so is its profiler: looking at a worker a hundred times a second takes a twentieth of a core.
        """
        if self.address is not None:
            yield self.address
            return
        import dask
        from distributed import LocalCluster

        settings = {
            "distributed.scheduler.worker-ttl": None,
            "distributed.deploy.lost-worker-timeout": _NEVER,
            "distributed.worker.profile.enabled": False,
        }
        with (
            dask.config.set(settings),
            LocalCluster(
                n_workers=self.workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
                env={"NUMBA_NUM_THREADS": self.threads},
            ) as cluster,
        ):
            address: str = cluster.scheduler_address
            yield address


def _call(function: Callable[[_Item], _Result], item: _Item) -> _Result:
    return function(item)
