"""Eight numbers at once in kernels: the same as one after the other."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit
from magiclens.kernels.eights import (
    EIGHT,
    eight_at,
    eight_times,
    four_and_four,
    lesser,
    minus,
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
    put_eight(out, np.uint64(24), lesser(first, second))
    return total(first)


def test_eight_numbers_at_once_are_as_one_after_the_other() -> None:
    a, b = RNG.random((2, 16)).astype(np.float32)
    out = np.zeros(4 * EIGHT, np.float32)
    sum_ = _everything(a, b, out)
    x, y = a[3:11], np.concatenate([b[9:13], b[1:5]])
    expected = [x + y, x - y, x * y + np.float32(0.5), np.minimum(x, y)]
    np.testing.assert_allclose(out.reshape(4, EIGHT), expected, rtol=1e-6)
    np.testing.assert_allclose(sum_, x.sum(), rtol=1e-6)
