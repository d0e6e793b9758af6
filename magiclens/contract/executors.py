"""The contract of executors, which work through lists of tasks, such as the runs of a sweep, and the built-in ones.

Some have other machines work on parts of one lens, too.

An executor is a pydantic model, as a stage is: its fields are its options, and ``type`` is the name that picks it.
"""

from __future__ import annotations

import multiprocessing
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from typing import ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from magiclens.contract.errors import StageError
from magiclens.kernels.spreading import Spreader

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Executor(BaseModel, ABC):
    """Base of all executors. Where a task is worked on must not change its result.

    Attributes:
        type: The name that picks the executor, such as ``--executor processes``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    type: ClassVar[str]

    @abstractmethod
    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result | Exception]:
        """Call a function with every item.

        Processes are started when the first result is asked for. They end with the last result, or when the iterator is
        closed.

        Args:
            function: What to call. It can be pickled, and it may be called twice with the same item, since a process
                that dies leaves its work unfinished.
            items: What to call it with; items can be pickled.

        Returns:
            The results in the order of the items, each as soon as it and all those before it are known. An item that
            fails stops no other: the exception takes the place of its result, a StageError if its process has died.
        """

    @contextmanager
    def spreader(self) -> Iterator[Spreader | None]:
        """Who does parts of one lens on other machines, until the block ends; None, the default, if nobody does."""
        yield None


class Serial(Executor):
    """Works on one item after the other, in this process."""

    type: ClassVar[str] = "serial"

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result | Exception]:
        """See ``Executor``. No item is begun before its result is asked for."""
        for item in items:
            try:
                yield function(item)
            except Exception as error:  # not BaseException: Ctrl-C and signals end the whole list
                yield error


class Processes(Executor):
    """Works on several items at a time, in processes of this machine that share its cores.

    Attributes:
        workers: Number of processes.
    """

    type: ClassVar[str] = "processes"

    workers: int = Field(default_factory=lambda: cores(), ge=1, le=256, description="processes; as many as cores")

    def map(self, function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result | Exception]:
        """See ``Executor``. A process that dies loses the item that it was working on, and is replaced."""
        free: SimpleQueue[ProcessPoolExecutor] = SimpleQueue()
        for _ in range(self.workers):
            free.put(self._process())
        # a thread waits for each process, so that results come in order and a dead process concerns its thread alone
        threads = ThreadPoolExecutor(self.workers)
        try:
            yield from threads.map(partial(self._work, free, function), items)
        finally:
            # waits for the items that are being worked on; then every process is in the queue again
            threads.shutdown(cancel_futures=True)
            while not free.empty():
                free.get().shutdown()

    def _process(self) -> ProcessPoolExecutor:
        """A pool of one process, so that its death costs one item; it starts with the first item."""
        # not forked: a child would get copies of the locks that numba's threads hold
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, spawn, _share_cores, (threads_each(self.workers),))

    def _work(
        self, free: SimpleQueue[ProcessPoolExecutor], function: Callable[[_Item], _Result], item: _Item
    ) -> _Result | Exception:
        process = free.get()  # never waits: there are as many processes as threads
        try:
            return process.submit(function, item).result()
        except BrokenProcessPool:
            process.shutdown()
            process = self._process()
            return StageError("the process that worked on this died")
        except Exception as error:
            return error
        finally:
            free.put(process)


def raising(results: Iterable[_Result | Exception]) -> Iterator[_Result]:
    """Results of an executor without exceptions: the first exception among them is raised."""
    for result in results:
        if isinstance(result, Exception):
            raise result
        yield result


def cores() -> int:
    """Number of cores that this process may use."""
    # affinity, where the system has it: a job scheduler may give a process fewer cores than the machine has
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_each(workers: int) -> int:
    """Number of threads for each of several processes that share the cores of this machine."""
    return max(1, cores() // workers)


def _share_cores(threads: int) -> None:
    """Limit numba's threads; called in a new process before numba is imported there, since it reads this once."""
    os.environ["NUMBA_NUM_THREADS"] = str(threads)
