"""The kernel of error diffusion."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit


@njit(cache=True)
def diffuse_errors(heights, layer, shares, between, tops):
    """Fill in the tops of columns, rounded by Floyd and Steinberg's error diffusion, see ``layers.tops_of``.

    Rows are passed in alternating directions, or patterns would lean to one side. What is left of a column goes to the
    next (7/16) and to those below: behind (3/16), under (5/16) and ahead of it (1/16). Columns beside the body, of no
    height, stay empty and pass nothing on.

    Args:
        heights: (rows, columns) float32, mm.
        layer: height of a layer, mm.
        shares: (L,) of a layer's height.
        between: (L,) from where on the next one is nearer.
        tops: (rows, columns) int32, to fill.
    """
    rows, columns = heights.shape
    steps = len(shares)
    here, below = np.zeros(columns + 2, np.float32), np.zeros(columns + 2, np.float32)
    for i in range(rows):
        ahead = 1 if i % 2 == 0 else -1
        here[:], below[:] = below, 0.0
        for step in range(columns):
            j = step if ahead == 1 else columns - 1 - step
            if heights[i, j] <= 0.0:
                tops[i, j] = 0
                continue
            wanted = heights[i, j] / layer + here[j + 1]
            whole = max(int(np.floor(wanted)), 0)
            k = np.searchsorted(between, wanted - whole, side="right")
            tops[i, j] = whole * steps + k
            left = np.float32(wanted - whole - (shares[k] if k < steps else 1.0))
            here[j + 1 + ahead] += left * np.float32(7 / 16)
            below[j + 1 - ahead] += left * np.float32(3 / 16)
            below[j + 1] += left * np.float32(5 / 16)
            below[j + 1 + ahead] += left * np.float32(1 / 16)
