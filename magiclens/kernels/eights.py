"""Eight float32 or int32 at once, in kernels.

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
    """numba's type of eight numbers of a type."""

    def __init__(self, of: types.Number) -> None:
        super().__init__(f"eight {of}")
        self.of = of


_int = ir.IntType(32)
_VECTORS: dict[Any, Any] = {
    types.float32: ir.VectorType(ir.FloatType(), EIGHT),
    types.int32: ir.VectorType(_int, EIGHT),
}
_EIGHTS: dict[Any, _Eight] = {of: _Eight(of) for of in _VECTORS}
_CONTRACT = ("contract",)
_instruction: Callable[[Callable[..., Any]], Any] = extending.intrinsic  # whose own types know no arguments of kernels


@register_model(_Eight)
class _EightModel(models.PrimitiveModel):
    def __init__(self, manager: Any, numba_type: _Eight):
        super().__init__(manager, numba_type, _VECTORS[numba_type.of])


def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Where the element of a flat array, the first argument, with the number of the second is in memory."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(array.data, [arguments[1]])


def _take(builder: Any, place: Any, vector: Any, align: int = 4) -> Any:
    return builder.load(builder.bitcast(place, vector.as_pointer()), align=align)


def _shuffle(builder: Any, a: Any, b: Any, order: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_int, len(order)), order))


def _in_all(builder: Any, value: Any) -> Any:
    none = ir.Constant(ir.VectorType(value.type, EIGHT), ir.Undefined)
    return _shuffle(builder, builder.insert_element(none, value, _int(0)), none, [0] * EIGHT)


@_instruction
def eight_at(_: Any, array: types.Array, at: types.Integer) -> tuple[Any, Callable[..., Any]]:
    """The eight numbers of a flat float32 or int32 array that begin at one; ``at`` is unsigned."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _take(builder, _place(context, builder, signature, arguments), _VECTORS[array.dtype])

    return _EIGHTS[array.dtype](array, types.uint64), build


@_instruction
def four_and_four(
    _: Any, array: types.Array, at: types.Integer, other: types.Integer
) -> tuple[Any, Callable[..., Any]]:
    """Four numbers of a flat float32 array that begin at one, and four that begin at another; both are unsigned."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        half = ir.VectorType(ir.FloatType(), EIGHT // 2)
        first, second = (_take(builder, builder.gep(data, [place]), half) for place in arguments[1:])
        return _shuffle(builder, first, second, list(range(EIGHT)))

    return _EIGHTS[types.float32](array, types.uint64, types.uint64), build


@_instruction
def put_eight(_: Any, array: types.Array, at: types.Integer, value: _Eight) -> tuple[Any, Callable[..., Any]]:
    """Write eight numbers into a flat array of theirs, from one of its elements on; ``at`` is unsigned."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _place(context, builder, signature, arguments)
        builder.store(arguments[2], builder.bitcast(place, arguments[2].type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, value), build


@_instruction
def eight_times(_: Any, value: types.Number) -> tuple[Any, Callable[..., Any]]:
    """Eight times the same float32 or int32."""
    return _EIGHTS[value](value), lambda _context, builder, _signature, values: _in_all(builder, values[0])


@_instruction
def plus(_: Any, a: _Eight, b: _Eight) -> tuple[Any, Callable[..., Any]]:
    """``a + b``"""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.fadd(*values, flags=_CONTRACT) if a.of is types.float32 else builder.add(*values)

    return a(a, b), build


@_instruction
def minus(_: Any, a: _Eight, b: _Eight) -> tuple[Any, Callable[..., Any]]:
    """``a - b``"""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.fsub(*values, flags=_CONTRACT) if a.of is types.float32 else builder.sub(*values)

    return a(a, b), build


@_instruction
def times_plus(_: Any, a: _Eight, b: _Eight, c: _Eight) -> tuple[Any, Callable[..., Any]]:
    """``a * b + c``, of float32"""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.fadd(builder.fmul(values[0], values[1], flags=_CONTRACT), values[2], flags=_CONTRACT)

    return a(a, b, c), build


@_instruction
def pairs_times_plus(
    _: Any, pairs: types.Array, at: types.Integer, by: types.Array, pair: types.Integer, sums: _Eight
) -> tuple[Any, Callable[..., Any]]:
    """Eight pairs of int16, each times the same pair: ``sums + first * first + second * second``, of int32.

    Many processors have an instruction for that.

    Args:
        pairs, at: a flat int16 array, and the unsigned place of the first pair's first number.
        by, pair: a flat int16 array, and the unsigned place of the first number of the pair to multiply by.
        sums: eight int32.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        both = ir.VectorType(ir.IntType(16), 2 * EIGHT)
        data = [context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 2)]
        first = _take(builder, builder.gep(data[0], [arguments[1]]), both, 2)
        second = _take(builder, builder.gep(data[1], [arguments[3]]), _int, 2)
        factors = first, builder.bitcast(_in_all(builder, second), both)
        # said so that LLVM sees the instruction of x86: all products, and then those of each pair added
        wide = ir.VectorType(_int, 2 * EIGHT)
        products = builder.mul(*(builder.sext(value, wide) for value in factors), flags=("nsw",))
        first, second = (_shuffle(builder, products, products, list(range(odd, 2 * EIGHT, 2))) for odd in (0, 1))
        return builder.add(arguments[4], builder.add(first, second))

    return sums(pairs, types.uint64, by, types.uint64, sums), build


@_instruction
def lesser(_: Any, a: _Eight, b: _Eight) -> tuple[Any, Callable[..., Any]]:
    """The lesser of ``a`` and ``b``, of int32, in each place."""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.select(builder.icmp_signed("<", *values), *values)

    return a(a, b), build


@_instruction
def at_most(_: Any, a: _Eight, limit: types.Integer) -> tuple[Any, Callable[..., Any]]:
    """A number whose bit k says whether the int32 of ``a`` in place k is at most a limit, int32."""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        bits = builder.icmp_signed("<=", values[0], _in_all(builder, values[1]))
        return builder.zext(builder.bitcast(bits, ir.IntType(EIGHT)), ir.IntType(64))

    return types.int64(a, types.int32), build


@_instruction
def lowest_bit(_: Any, bits: types.Integer) -> tuple[Any, Callable[..., Any]]:
    """Which is the lowest bit of a number, not 0, that is set."""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.cttz(values[0], ir.IntType(1)(1))

    return types.int64(types.int64), build


@_instruction
def total(_: Any, a: _Eight) -> tuple[Any, Callable[..., Any]]:
    """The sum of the eight float32."""

    def build(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        value = values[0]
        for half in (4, 2, 1):
            other = _shuffle(builder, value, value, [(k + half) % EIGHT for k in range(EIGHT)])
            value = builder.fadd(value, other)
        return builder.extract_element(value, _int(0))

    return types.float32(a), build
