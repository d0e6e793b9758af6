"""Lanes: four numbers that kernels add, subtract and multiply at once, as processors do with a vector.

The compiler finds such vectors itself in long loops. The few channels of a pixel, side by side in memory, are none.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model
from numpy.typing import NDArray

LANES = 4
"""Numbers in a vector; processors that have no such vectors take them one by one."""
_VECTOR = ir.VectorType(ir.FloatType(), LANES)


class _Lanes(types.Type):
    """The type of ``LANES`` float32 in kernels."""

    def __init__(self) -> None:
        super().__init__(name="lanes of float32")


_LANES = _Lanes()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _Lanes) -> None:
        super().__init__(manager, kind, _VECTOR)


@infer_global(operator.add)
@infer_global(operator.sub)
@infer_global(operator.mul)
class _Arithmetic(AbstractTemplate):
    """Of vectors, and of vectors and numbers, which then are the same in all lanes."""

    def generic(self, args: Any, kws: Any) -> Any:
        if _LANES in args and all(kind in (_LANES, types.float32) for kind in args):
            return signature(_LANES, _LANES, _LANES)
        return None


def _in_all(builder, value):
    vector = ir.VectorType(value.type, LANES)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


@lower_cast(types.float32, _LANES)
def _in_all_lanes(context, builder, kind, to, value):
    return _in_all(builder, value)


def _lower(operation, instruction):
    def generate(context, builder, signature, arguments):
        return getattr(builder, instruction)(*arguments)

    lower_builtin(operation, _LANES, _LANES)(generate)


_lower(operator.add, "fadd")
_lower(operator.sub, "fsub")
_lower(operator.mul, "fmul")


def _lanes_at(typing_context, values, at):
    def generate(context, builder, signature, arguments):
        array = context.make_array(values)(context, builder, arguments[0])
        place = builder.bitcast(builder.gep(array.data, [arguments[1]]), _VECTOR.as_pointer())
        return builder.load(place, align=4)

    return _LANES(values, types.uintp), generate


lanes_at: Any = intrinsic(_lanes_at)
"""In a kernel: ``LANES`` numbers of a contiguous float32 array, from a flat index on. Arrays are made by ``with_room``,
so that what is read beyond their end is there."""


def _keep_lanes(typing_context, values, at, lanes):
    def generate(context, builder, signature, arguments):
        array = context.make_array(values)(context, builder, arguments[0])
        place = builder.bitcast(builder.gep(array.data, [arguments[1]]), _VECTOR.as_pointer())
        builder.store(arguments[2], place, align=4)
        return context.get_dummy_value()

    return types.void(values, types.uintp, _LANES), generate


keep_lanes: Any = intrinsic(_keep_lanes)
"""In a kernel: write ``LANES`` numbers into a contiguous float32 array, from a flat index on."""


def _no_lanes(typing_context):
    def generate(context, builder, signature, arguments):
        return ir.Constant(_VECTOR, [0.0] * LANES)

    return _LANES(), generate


no_lanes: Any = intrinsic(_no_lanes)
"""In a kernel: zeros, to begin a sum with."""


def _sum_of_lanes(typing_context, lanes, count):
    def generate(context, builder, signature, arguments):
        numbers = ir.VectorType(arguments[1].type, LANES)
        counts = builder.icmp_signed("<", ir.Constant(numbers, list(range(LANES))), _in_all(builder, arguments[1]))
        kept = builder.select(counts, arguments[0], ir.Constant(_VECTOR, [0.0] * LANES))
        kind = ir.FunctionType(ir.FloatType(), [ir.FloatType(), _VECTOR])
        add = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fadd.v{LANES}f32")
        return builder.call(add, [ir.Constant(ir.FloatType(), 0.0), kept], fastmath=("reassoc",))

    return types.float32(_LANES, types.intp), generate


sum_of_lanes: Any = intrinsic(_sum_of_lanes)
"""In a kernel: the sum of the first so many lanes. The others may hold anything, such as a next pixel's channels."""


def with_room(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Zeros of a shape, float32, behind which ``lanes_at`` may read."""
    size = int(np.prod(shape))
    return np.zeros(size + LANES - 1, np.float32)[:size].reshape(shape)
