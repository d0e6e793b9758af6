"""What lies across the rows of a raster."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray

HAIR_MM = 1e-7
"""Spans are widened by so much that rounding leaves nothing out."""


def by_row(low: FloatArray, high: FloatArray, y_low: FloatArray, y_high: FloatArray) -> tuple[IntArray, IntArray]:
    """For each of the rows, which go from y_low to y_high and ascend, the spans from ``low`` to ``high`` that meet it.

    As (rows + 1,) pointers into the (K,) indices of the spans, in order.
    """
    first = np.searchsorted(y_high, low - HAIR_MM, "left")
    count = np.maximum(np.searchsorted(y_low, high + HAIR_MM, "right") - first, 0)
    member = np.repeat(np.arange(len(low)), count)
    row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
    order = np.argsort(row, kind="stable")
    pointer = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(y_low)))])
    return pointer, member[order]
