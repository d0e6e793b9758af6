"""Kernels that kernels call: linked into their callers, and the same for whoever calls them."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import contextmanager

import numba
import numpy as np
import pytest
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.event import Event, Listener, install_listener

from magiclens.kernels.compiler import njit


class Compilations(Listener):
    """Names of functions that are compiled."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, event: Event) -> None:
        self.names.append(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: Event) -> None:
        pass


@contextmanager
def watched() -> Iterator[list[str]]:
    watching = Compilations()
    with install_listener("numba:compile", watching):
        yield watching.names


def test_a_kernel_gets_its_wrapper_once_python_calls_it() -> None:
    @njit()
    def inner(a):
        return a + 1

    @njit()
    def outer(a):
        return inner(a) + inner(a)

    with watched() as names:
        assert [outer(1), outer(2), inner(1), inner(2), outer(3)] == [4, 6, 2, 3, 8]
    assert names == ["outer", "inner", "inner"]


def test_what_python_has_called_is_linked_as_it_is() -> None:
    @njit()
    def inner(a):
        return a + 1

    @njit()
    def outer(a):
        return 2 * inner(a)

    with watched() as names:
        assert [inner(1), outer(1)] == [2, 4]
    assert names == ["inner", "outer"]


def test_errors_of_a_linked_kernel_arrive_with_their_arguments() -> None:
    @njit()
    def inner(a):
        if a > 100:
            raise ValueError("too large", a)
        return np.zeros(a)

    @njit()
    def outer(a):
        return inner(a).size

    assert outer(3) == 3
    with pytest.raises(ValueError, match="too large") as error:
        outer(101)
    assert error.value.args == ("too large", 101)


def test_a_linked_kernel_may_call_itself() -> None:
    @njit()
    def fibonacci(n):
        if n < 2:
            return n
        return fibonacci(n - 1) + fibonacci(n - 2)

    @njit()
    def outer(n):
        return fibonacci(n)

    assert [outer(10), fibonacci(11)] == [55, 89]


def test_kernels_of_others_call_ours_and_ours_theirs() -> None:
    @numba.njit
    def theirs(a):
        return np.full(2, a).sum()

    @njit()
    def ours(a):
        return theirs(a) + np.zeros(2).size

    @numba.njit
    def caller(a):
        return ours(a) + np.full(2, a).sum()

    @numba.vectorize
    def each(a):
        return ours(a)

    assert [caller(1), ours(1), theirs(1)] == [6, 4, 2]
    np.testing.assert_array_equal(each(np.arange(3)), [2, 4, 6])


def test_numba_itself_is_left_as_it_is() -> None:
    @numba.njit
    def theirs(a):
        return np.zeros(a)

    assert theirs(2).size == 2
    assert type(theirs.overloads[(numba.int64,)].library) is JITCodeLibrary
    assert JITCPUCodegen._library_class is JITCodeLibrary


def test_kernels_loop_in_threads_of_numba() -> None:
    @njit(parallel=True)
    def squares(count):
        out = np.empty(count)
        for k in numba.prange(count):
            out[k] = k * k
        return out

    np.testing.assert_array_equal(squares(100), np.arange(100) ** 2)


def test_a_kernel_goes_to_another_process_and_back() -> None:
    from magiclens.optics.refraction import refract

    assert pickle.loads(pickle.dumps(refract)) is refract
