"""Rows of numbers as text and back, some hundred times as fast as one number at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.exporting.digits_kernels import read_rows, write_rows
from magiclens.kernels.threads import side_by_side_ahead

_WIDEST = 21
"""Number of characters of the longest number: a sign, 19 digits, a point."""
_CHUNK = 1 << 16
"""Rows of numbers that are turned to text at one time."""


def rounded_rows(numbers: FloatArray | IntArray, around: Sequence[bytes], decimals: int = 0) -> Iterator[bytes]:
    """Rows of numbers as text, in pieces that are made in other threads while the caller packs or writes them.

    Args:
        numbers: (rows, K) what to write.
        around: K + 1 texts, before, between and after the numbers of each row.
        decimals: digits after the point, at most, to which numbers are rounded.

    Returns:
        The text of some rows after the other, ASCII.
    """

    def text(first: int) -> bytes:
        return text_rows(np.rint(numbers[first : first + _CHUNK] * 10**decimals).astype(np.int64), around, decimals)

    return side_by_side_ahead(text, range(0, len(numbers), _CHUNK))


def text_rows(numbers: IntArray, around: Sequence[bytes], decimals: int = 0) -> bytes:
    """Rows of numbers as text. Zeros at the end of decimals are left out.

    Args:
        numbers: (rows, K) int64, in units of the last decimal: with 6 decimals 1500000 is 1.5.
        around: K + 1 texts, before, between and after the numbers of each row.
        decimals: digits after the point, at most.

    Returns:
        The text, ASCII.
    """
    glue, ends = _joined(around)
    # as if every number were the longest: the kernel cannot make the array longer
    room = len(numbers) * (len(glue) + _WIDEST * numbers.shape[1])
    out = np.empty(room, np.uint8)
    used = write_rows(np.ascontiguousarray(numbers, np.int64), glue, ends, decimals, out)
    return out[:used].tobytes()


def numbers_of(text: bytes, around: Sequence[bytes], first: int = 0, end: int | None = None) -> FloatArray | None:
    """The numbers of rows that ``text_rows`` has written, each in a line of its own.

    Args:
        text: Holds the rows, ASCII. It may be so long that nobody wants a copy of a part.
        around: The texts around the numbers of each row.
        first: Where in the text the rows begin.
        end: Where they end; None if that is the text's end.

    Returns:
        (rows, K) float64, as ``float`` would read them; None if the text has any other form.
    """
    out = np.empty((text.count(b"\n", first, end), len(around) - 1))
    return out if read_rows(np.frombuffer(text, np.uint8)[first:end], *_joined(around), out) else None


def _joined(around: Sequence[bytes]) -> tuple[NDArray[np.uint8], IntArray]:
    """The texts one after the other, and where each of them ends."""
    return np.frombuffer(b"".join(around), np.uint8), np.cumsum([len(part) for part in around])
