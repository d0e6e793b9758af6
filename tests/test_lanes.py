"""Lanes: four numbers at once give what numbers give one by one."""

from __future__ import annotations

import numpy as np
import pytest

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.lanes import LANES, keep_lanes, lanes_at, no_lanes, sum_of_lanes, with_room


@njit()
def weighted_squares(values: FloatArray, count: int) -> float:
    """Sum over rows i, and over the first ``count`` columns, of ``i value (value - 1)``."""
    total = no_lanes()
    for i in range(len(values)):
        row = lanes_at(values, np.uint64(i * values.shape[1]))
        total = total + row * (row - np.float32(1.0)) * np.float32(i)
    return sum_of_lanes(total, count)


@njit()
def copied(values: FloatArray, at: int, out: FloatArray) -> None:
    keep_lanes(out, np.uint64(1), lanes_at(values, np.uint64(at)))


@pytest.mark.parametrize("columns", range(1, LANES + 1))
def test_rows_of_up_to_four_numbers_are_summed_without_what_follows_them(columns: int) -> None:
    values = with_room((5, columns))
    values[...] = np.random.default_rng(0).random(values.shape)
    expected = (np.arange(5)[:, None] * values * (values - 1)).sum()
    assert weighted_squares(values, columns) == pytest.approx(expected, rel=1e-5)


def test_lanes_are_read_and_kept_from_any_place_on() -> None:
    values, out = np.arange(9, dtype=np.float32), np.zeros(6, np.float32)
    copied(values, 3, out)
    assert out.tolist() == [0, 3, 4, 5, 6, 0]
