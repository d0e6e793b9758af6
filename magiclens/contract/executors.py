"""The contract of executors: who works through a list of tasks, such as the runs of a sweep, and where.

An executor is a pydantic model, as a stage is: its fields are its options, ``type`` is the name it is picked by.
"""

from __future__ import annotations

import multiprocessing
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from queue import SimpleQueue
from typing import ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from magiclens.contract.errors import StageError

Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(BaseModel, ABC):
    """Base of all executors. Where a task is worked on never changes its result."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    type: ClassVar[str]

    @abstractmethod
    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result | Exception]:
        """``function`` of every item, in the items' order, each as soon as it and all before it are there.

        An item that fails stops no other: what it raised stands in its place; a StageError if its process died.
        ``function`` and the items can be pickled, and equal work can be done twice, since a process that dies may leave
        it unfinished. What the executor needs is started with the first result and ended with the last, or when the
        iterator is closed.
        """


class Serial(Executor):
    """One item after the other, in this process."""

    type: ClassVar[str] = "serial"

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result | Exception]:
        """Nothing is begun before it is asked for."""
        for item in items:
            try:
                yield function(item)
            except Exception as error:
                yield error


class Processes(Executor):
    """Several items at a time, in processes of this machine that share its cores."""

    type: ClassVar[str] = "processes"

    workers: int = Field(default_factory=lambda: cores(), ge=1, le=256, description="processes; as many as cores")

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result | Exception]:
        """A process that dies takes its item with it and is replaced."""
        free: SimpleQueue[ProcessPoolExecutor] = SimpleQueue()
        for _ in range(self.workers):
            free.put(self._process())
        threads = ThreadPoolExecutor(self.workers)
        try:
            yield from threads.map(partial(self._work, free, function), items)
        finally:
            threads.shutdown(cancel_futures=True)
            while not free.empty():
                free.get().shutdown()

    def _process(self) -> ProcessPoolExecutor:
        """One process; it starts with its first item. Forking would copy the locks of numba's threads."""
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, spawn, _share_cores, (threads_each(self.workers),))

    def _work(
        self, free: SimpleQueue[ProcessPoolExecutor], function: Callable[[Item], Result], item: Item
    ) -> Result | Exception:
        process = free.get()
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


def raising(results: Iterable[Result | Exception]) -> Iterator[Result]:
    """The results of an executor, for those who need all of them: raises the first exception among them."""
    for result in results:
        if isinstance(result, Exception):
            raise result
        yield result


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_each(workers: int) -> int:
    """Threads for each of so many processes that share this machine."""
    return max(1, cores() // workers)


def _share_cores(threads: int) -> None:
    """Called in a new process, before numba is imported there."""
    os.environ["NUMBA_NUM_THREADS"] = str(threads)
