"""The contract of executors."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context

import pytest

from magiclens.contract.executors import Executor
from magiclens.kernels.spreading import shares, spread, spreading_by


class ExecutorContract:
    """Checks that results come in order, and that an item that fails stops no other.

    Attributes:
        executor: The executor to test; a subclass sets it.
    """

    executor: Executor

    def test_results_come_in_the_order_of_the_items(self) -> None:
        """Also when the first item takes longest."""
        assert list(self.executor.map(_square_later_when_small, range(5))) == [0, 1, 4, 9, 16]

    def test_no_items_give_no_results(self) -> None:
        """Nothing to do is no failure."""
        assert list(self.executor.map(_square_later_when_small, [])) == []

    def test_an_item_that_fails_stops_no_other(self) -> None:
        """The exception takes the place of the result."""
        first, error, last = self.executor.map(_inverse, [1.0, 0.0, 2.0])
        assert (first, last) == (1.0, 0.5)
        assert isinstance(error, ZeroDivisionError), f"got {error!r} for an item that raises ZeroDivisionError"

    def test_it_may_be_stopped_before_the_end(self) -> None:
        """Closing the iterator ends the work; the executor can be used again."""
        results = self.executor.map(_square_later_when_small, range(100))
        assert next(results) == 0
        results.close()  # type: ignore[attr-defined]
        assert list(self.executor.map(_square_later_when_small, [3])) == [9]

    def test_what_it_spreads_comes_in_order(self) -> None:
        """If it has other machines for parts of a lens: every index is done once, and what all items share is there."""
        with self.executor.spreader() as spreader, spreading_by(spreader):
            if spreader is None:
                pytest.skip("it spreads nothing")
            found = list(spread(_scaled, 10, shares(5, finer=3)))
            with pytest.raises(ZeroDivisionError):
                list(spread(_divided, 1, [1, 0]))
        assert [number for number, _ in found] == list(range(len(found)))
        assert [index for _, block in found for index in block] == [0, 10, 20, 30, 40]

    def test_several_threads_may_spread_at_a_time(self) -> None:
        """Files are written while analyses go on, for instance."""
        with self.executor.spreader() as spreader, spreading_by(spreader):
            if spreader is None:
                pytest.skip("it spreads nothing")
            with ThreadPoolExecutor(3) as threads:
                loops = [threads.submit(copy_context().run, _all_scaled, factor) for factor in (2, 3, 4)]
        assert [loop.result() for loop in loops] == [[factor * index for index in range(8)] for factor in (2, 3, 4)]


# functions of the module, not of a test: executors may send them to other processes
def _square_later_when_small(number: int) -> int:
    time.sleep(0.1 / (number + 1))
    return number * number


def _inverse(number: float) -> float:
    return 1 / number


def _scaled(factor: int, block: range) -> list[int]:
    return [factor * index for index in block]


def _all_scaled(factor: int) -> list[int]:
    return [index for _, block in spread(_scaled, factor, shares(8, finer=2)) for index in block]


def _divided(number: int, by: int) -> float:
    return number / by
