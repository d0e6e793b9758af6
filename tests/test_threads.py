"""Loops in threads: every index once, whatever the number of threads."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numba import njit

from magiclens.kernels.threads import LoopPart, in_threads, side_by_side, side_by_side_ahead


@njit(nogil=True)
def count_up(part, step, out):  # type: ignore[no-untyped-def]
    for k in range(part.first, part.end):
        out[k] += step * (k + 1)


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 2, 3, 17, 1000])
def test_every_index_is_done_once(threads: int, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.get_num_threads", lambda: threads)
    out = np.zeros(count)
    in_threads(count_up, count, 2.0, out)
    np.testing.assert_array_equal(out, 2.0 * np.arange(1, count + 1))


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("indices", [range(0), range(5, 5), range(3, 20), range(990, 1000)])
def test_of_a_range_only_its_own_indices_are_done(
    threads: int, indices: range, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("numba.get_num_threads", lambda: threads)
    out = np.zeros(1000)
    in_threads(count_up, indices, 2.0, out)
    np.testing.assert_array_equal(np.flatnonzero(out), list(indices))


def test_what_a_part_raises_is_raised() -> None:
    def fail(part: LoopPart) -> None:
        if part.end == 100:
            raise ValueError(f"{part.first} to {part.end}")

    with pytest.raises(ValueError, match="to 100"):
        in_threads(fail, 100)


def test_after_a_mistake_no_other_part_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    def fail(part: LoopPart) -> None:
        begun.append(part.first)
        raise ValueError("this part")

    monkeypatch.setattr("numba.get_num_threads", lambda: 2)
    with pytest.raises(ValueError, match="this part"):
        in_threads(fail, 100)
    assert len(begun) <= 2


def test_functions_side_by_side_return_in_order_and_may_run_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.get_num_threads", lambda: 3)

    def total(count: int) -> float:
        out = np.zeros(count)
        in_threads(count_up, count, 2.0, out)
        return float(out.sum())

    assert side_by_side(total, range(1, 40)) == [n * (n + 1) for n in range(1, 40)]


def test_results_come_in_order_and_only_a_few_are_ready_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.get_num_threads", lambda: 2)
    asked: list[int] = []

    def items() -> Iterator[int]:
        for k in range(50):
            asked.append(k)
            yield k

    results = side_by_side_ahead(lambda k: 2 * k, items())
    for k in range(50):
        assert next(results) == 2 * k
        assert len(asked) <= k + 5
    assert list(results) == []
    assert list(side_by_side_ahead(str, [])) == []


def test_what_one_of_many_raises_is_raised_in_its_turn() -> None:
    results = side_by_side_ahead(lambda k: 1 // k, [1, 0, 1])
    assert next(results) == 1
    with pytest.raises(ZeroDivisionError):
        next(results)
