"""Eight numbers at once in kernels: the same as one after the other."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit
from magiclens.kernels.eights import (
    EIGHT,
    at_most,
    eight_at,
    eight_times,
    four_and_four,
    lesser,
    lowest_bit,
    minus,
    pairs_times_plus,
    plus,
    put_eight,
    times_plus,
    total,
)  # fmt: skip

RNG = np.random.default_rng(0)


@njit()
def _everything(a, b, out):  # type: ignore[no-untyped-def]
    first, second = eight_at(a, np.uint64(3)), four_and_four(b, np.uint64(9), np.uint64(1))
    put_eight(out, np.uint64(0), plus(first, second))
    put_eight(out, np.uint64(8), minus(first, second))
    put_eight(out, np.uint64(16), times_plus(first, second, eight_times(np.float32(0.5))))
    return total(first)


def test_eight_numbers_at_once_are_as_one_after_the_other() -> None:
    a, b = RNG.random((2, 16)).astype(np.float32)
    out = np.zeros(3 * EIGHT, np.float32)
    sum_ = _everything(a, b, out)
    x, y = a[3:11], np.concatenate([b[9:13], b[1:5]])
    expected = [x + y, x - y, x * y + np.float32(0.5)]
    np.testing.assert_allclose(out.reshape(3, EIGHT), expected, rtol=1e-6)
    np.testing.assert_allclose(sum_, x.sum(), rtol=1e-6)


@njit()
def _everything_whole(a, b, pairs, by, out):  # type: ignore[no-untyped-def]
    first, second = eight_at(a, np.uint64(3)), eight_times(b)
    put_eight(out, np.uint64(0), plus(first, second))
    put_eight(out, np.uint64(8), minus(first, second))
    put_eight(out, np.uint64(16), lesser(first, second))
    put_eight(out, np.uint64(24), pairs_times_plus(pairs, np.uint64(2), by, np.uint64(4), first))
    bits = at_most(first, b)
    return bits, lowest_bit(bits)


def test_eight_whole_numbers_at_once_are_as_one_after_the_other() -> None:
    a, b, out = RNG.integers(-9, 9, 16).astype(np.int32), np.int32(1), np.zeros(4 * EIGHT, np.int32)
    a[3:6] = 5, 6, 1
    pairs, by = RNG.integers(-32000, 32000, 20).astype(np.int16), np.array([0, 0, 0, 0, -30000, 16384], np.int16)
    bits, lowest = _everything_whole(a, b, pairs, by, out)
    products = pairs[2:18].reshape(EIGHT, 2).astype(int) @ by[4:].astype(int)
    np.testing.assert_array_equal(
        out.reshape(4, EIGHT), [a[3:11] + 1, a[3:11] - 1, np.minimum(a[3:11], 1), a[3:11] + products]
    )
    assert bits == sum(2**k for k in range(EIGHT) if a[3 + k] <= b)
    assert lowest == 2
