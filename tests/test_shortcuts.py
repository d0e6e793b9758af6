"""Shortcuts through numba's compiler: they leave out only what has no effect."""

from __future__ import annotations

import numpy as np
from numba.core.compiler import DefaultPassBuilder, Flags
from numba.core.typed_passes import NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes

from magiclens.kernels.compiler import njit
from magiclens.kernels.shortcuts import QuickFlags, QuickRewrites, steps_needed


class _NumbasState:
    flags, func_ir = Flags(), None


def _steps():
    return DefaultPassBuilder.define_nopython_pipeline(_NumbasState()).passes


def test_quick_flags_are_numbas_flags() -> None:
    flags = Flags()
    flags.nrt, flags.error_model = True, "numpy"
    quick = QuickFlags(flags)
    assert quick.values() == flags.values()
    assert quick == flags == quick.copy()
    assert hash(quick) == hash(flags)
    quick.nrt = False
    assert quick != flags
    assert QuickFlags() == Flags() != quick


def test_a_flag_at_its_default_is_as_one_that_is_not_set() -> None:
    flags = QuickFlags()
    flags.nrt = QuickFlags().nrt
    assert flags == QuickFlags()


def test_only_functions_within_functions_need_to_be_taken_in() -> None:
    def plain(a):
        return a + 1

    def nested(a):
        def inner(b):
            return b + 1

        return inner(a)

    assert InlineClosureLikes not in dict(steps_needed(_steps(), plain.__code__))
    assert InlineClosureLikes in dict(steps_needed(_steps(), nested.__code__))
    for function in (plain, nested):
        steps = dict(steps_needed(_steps(), function.__code__))
        assert QuickRewrites in steps
        assert NopythonRewrites not in steps
        assert njit()(function)(1) == 2


def test_expressions_of_arrays_become_one_loop() -> None:
    @njit()
    def combined(a, b):
        return np.sqrt(a * b + 1) - a

    @njit()
    def whole(a):
        return -a

    a, b = np.arange(4.0), np.full(4, 2.0)
    np.testing.assert_array_equal(combined(a, b), np.sqrt(a * b + 1) - a)
    np.testing.assert_array_equal(whole(a), -a)
    assert combined(3.0, 1.0) == -1.0


def test_lists_and_names_of_fields_are_understood() -> None:
    @njit()
    def listed(a):
        return np.array([a, 2.0 * a]).sum()

    @njit()
    def named(rows):
        return rows[0]["x"] + rows[1]["x"]

    assert listed(1.5) == 4.5
    assert named(np.array([(1.0,), (2.0,)], np.dtype([("x", np.float64)]))) == 3.0
