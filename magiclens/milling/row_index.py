"""Which spans of y meet which rows of a raster."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray

HAIR_MM = 1e-7
"""Spans are widened by this length, so that rounding leaves none out."""


class RowIndex(NamedTuple):
    """For each row, the spans that meet it: ``member[start[row]:start[row + 1]]``, ascending.

    Args:
        start: (rows + 1,) int64, where the spans of each row begin in ``member``.
        member: (K,) int64, indices of spans.
    """

    start: IntArray
    member: IntArray


def index_rows(low: FloatArray, high: FloatArray, y_low: FloatArray, y_high: FloatArray) -> RowIndex:
    """Find the spans that meet each row.

    Args:
        low, high: (S,) where each span begins and ends, mm.
        y_low, y_high: (rows,) where each row begins and ends, mm, both ascending.

    Returns:
        The spans of each row.
    """
    first = np.searchsorted(y_high, low - HAIR_MM, "left")
    count = np.maximum(np.searchsorted(y_low, high + HAIR_MM, "right") - first, 0)
    member = np.repeat(np.arange(len(low)), count)
    # the rows of a span follow each other: first, first + 1, ...
    row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
    order = np.argsort(row, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(y_low)))])
    return RowIndex(start, member[order])
