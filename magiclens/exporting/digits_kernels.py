"""Kernels that write integers as decimal text, and read it."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit

_MINUS, _POINT, _ZERO = 45, 46, 48
"""ASCII codes."""
_EXACT = 1 << 53
"""Up to this integer, and divided by 10**22 at most, a number is the float64 that is closest to its text."""


@njit(cache=True, nogil=True)
def write_rows(numbers, glue, ends, decimals, out):
    """Write rows of numbers with text around them; returns how many characters were written.

    Args:
        numbers: (rows, K) int64, in units of the last decimal.
        glue: uint8, the texts before, between and after the numbers of a row, one after the other.
        ends: (K + 1,) where each of these texts ends in ``glue``.
        decimals: digits after the point, at most; zeros at the end are left out.
        out: uint8, the text, long enough.
    """
    at = np.int64(0)
    for row in range(len(numbers)):
        start = 0
        for column in range(numbers.shape[1] + 1):
            for k in range(start, ends[column]):
                out[at] = glue[k]
                at += 1
            start = ends[column]
            if column < numbers.shape[1]:
                at = _number(numbers[row, column], decimals, out, at)
    return at


@njit(cache=True)
def _number(value, decimals, out, at):
    """Write a number, its digits from the last to the first; returns where it ends."""
    if value < 0:
        out[at] = _MINUS
        at, value = at + 1, -value
    while decimals > 0 and value % 10 == 0:
        value, decimals = value // 10, decimals - 1
    # at least one digit before the point: 0.05, not .05
    length, rest = 1, value // 10
    while rest > 0 or length <= decimals:
        length, rest = length + 1, rest // 10
    end = at + length + (1 if decimals > 0 else 0)
    k = end
    for digit in range(length):
        if digit == decimals and decimals > 0:
            k -= 1
            out[k] = _POINT
        k -= 1
        out[k] = _ZERO + value % 10
        value //= 10
    return end


@njit(cache=True)
def read_rows(text, glue, ends, out):
    """Read rows of numbers that have the same text around them; returns whether the text holds them and nothing else.

    Args:
        text: uint8, what ``write_rows`` writes.
        glue: uint8, see ``write_rows``.
        ends: (K + 1,), see ``write_rows``.
        out: (rows, K) float64, the numbers.
    """
    at = 0
    for row in range(len(out)):
        start = 0
        for column in range(out.shape[1] + 1):
            if at + ends[column] - start > len(text):
                return False
            for k in range(start, ends[column]):
                if text[at] != glue[k]:
                    return False
                at += 1
            start = ends[column]
            if column < out.shape[1]:
                at, number = _read_number(text, at)
                if at < 0:
                    return False
                out[row, column] = number
    return at == len(text)


@njit(cache=True)
def _read_number(text, at):
    """Where a number without exponent ends, and its value; -1 and 0 if there is none, or none that is exact."""
    negative = at < len(text) and text[at] == _MINUS
    at += 1 if negative else 0
    value, digits, divisor, point = 0, 0, 1.0, False
    while at < len(text):
        code = text[at]
        if code == _POINT and not point:
            point = True
        elif _ZERO <= code <= _ZERO + 9:
            value, digits = value * 10 + (code - _ZERO), digits + 1
            divisor *= 10.0 if point else 1.0
            if value > _EXACT or digits > 22:
                return -1, 0.0
        else:
            break
        at += 1
    if digits == 0:
        return -1, 0.0
    return at, (-value if negative else value) / divisor
