"""Eight float32 at once, in kernels.

numba puts long loops into vector instructions by itself, but not sums of a few numbers, nor loops that keep several
sums in registers: these say with the functions below what each instruction does. A value of eight numbers exists in
kernels only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending
from numba.core import types
from numba.extending import models, register_model

EIGHT = 8
"""How many numbers there are in a value."""


class _Eight(types.Type):
    """numba's type of eight float32."""

    def __init__(self) -> None:
        super().__init__("eight float32")


_eight, _vector = _Eight(), ir.VectorType(ir.FloatType(), EIGHT)
_CONTRACT = ("contract",)
_instruction: Callable[[Callable[..., Any]], Any] = extending.intrinsic  # whose own types know no arguments of kernels


@register_model(_Eight)
class _EightModel(models.PrimitiveModel):
    def __init__(self, manager: Any, numba_type: types.Type):
        super().__init__(manager, numba_type, _vector)


def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Where the element of a flat float32 array, the first argument, with the number of the second is in memory."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(array.data, [arguments[1]])


def _take(builder: Any, place: Any, count: int) -> Any:
    vector = ir.VectorType(ir.FloatType(), count)
    return builder.load(builder.bitcast(place, vector.as_pointer()), align=4)


@_instruction
def eight_at(_: Any, array: types.Array, at: types.Integer) -> tuple[Any, Callable[..., Any]]:
    """The eight numbers of a flat float32 array that begin at one; ``at`` is unsigned."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _take(builder, _place(context, builder, signature, arguments), EIGHT)

    return _eight(array, types.uint64), build


@_instruction
def four_and_four(
    _: Any, array: types.Array, at: types.Integer, other: types.Integer
) -> tuple[Any, Callable[..., Any]]:
    """Four numbers of a flat float32 array that begin at one, and four that begin at another; both are unsigned."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        halves = [_take(builder, builder.gep(data, [place]), EIGHT // 2) for place in arguments[1:]]
        order = ir.Constant(ir.VectorType(ir.IntType(32), EIGHT), list(range(EIGHT)))
        return builder.shuffle_vector(*halves, order)

    return _eight(array, types.uint64, types.uint64), build


@_instruction
def put_eight(_: Any, array: types.Array, at: types.Integer, value: _Eight) -> tuple[Any, Callable[..., Any]]:
    """Write eight numbers into a flat float32 array, from one of its elements on; ``at`` is unsigned."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, signature, arguments)
        builder.store(arguments[2], builder.bitcast(place, _vector.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, _eight), build


@_instruction
def eight_times(_: Any, value: types.Float) -> tuple[Any, Callable[..., Any]]:
    """Eight times the same number."""

    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        one = builder.insert_element(ir.Constant(_vector, ir.Undefined), arguments[0], ir.IntType(32)(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), EIGHT), [0] * EIGHT)
        return builder.shuffle_vector(one, ir.Constant(_vector, ir.Undefined), zeros)

    return _eight(types.float32), build


@_instruction
def plus(_: Any, a: _Eight, b: _Eight) -> tuple[Any, Callable[..., Any]]:
    """``a + b``"""
    return _eight(a, b), lambda _context, builder, _signature, values: builder.fadd(*values, flags=_CONTRACT)


@_instruction
def minus(_: Any, a: _Eight, b: _Eight) -> tuple[Any, Callable[..., Any]]:
    """``a - b``"""
    return _eight(a, b), lambda _context, builder, _signature, values: builder.fsub(*values, flags=_CONTRACT)


@_instruction
def times_plus(_: Any, a: _Eight, b: _Eight, c: _Eight) -> tuple[Any, Callable[..., Any]]:
    """``a * b + c``"""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.fadd(builder.fmul(values[0], values[1], flags=_CONTRACT), values[2], flags=_CONTRACT)

    return _eight(a, b, c), build


@_instruction
def lesser(_: Any, a: _Eight, b: _Eight) -> tuple[Any, Callable[..., Any]]:
    """The lesser of ``a`` and ``b`` in each place, ``b`` where one is not a number."""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *values), *values)

    return _eight(a, b), build


@_instruction
def total(_: Any, a: _Eight) -> tuple[Any, Callable[..., Any]]:
    """The sum of the eight numbers."""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        value = values[0]
        for half in (4, 2, 1):
            order = ir.Constant(ir.VectorType(ir.IntType(32), EIGHT), [(k + half) % EIGHT for k in range(EIGHT)])
            value = builder.fadd(value, builder.shuffle_vector(value, ir.Constant(_vector, ir.Undefined), order))
        return builder.extract_element(value, ir.IntType(32)(0))

    return types.float32(a), build
