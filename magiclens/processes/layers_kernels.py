"""The kernel of error diffusion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit


class Rounding(NamedTuple):
    """How heights become layers.

    Args:
        layer: height of a layer, mm.
        shares: (L,) of a layer's height.
        between: (L,) from where on the next one is nearer.
        weights: (rows, 2 reach + 1) float32, see ``diffusion_weights``.
    """

    layer: float
    shares: FloatArray
    between: FloatArray
    weights: FloatArray


@njit(cache=True)
def diffuse_errors(heights, rounding, tops):
    """Fill in the tops of columns, rounded by error diffusion, see ``layers.tops_of``.

    Rows are passed in alternating directions, or patterns would lean to one side. What is left of a column goes to
    those ahead of it and to those of the next rows, by the weights. Columns beside the body, of no height, stay empty
    and pass nothing on.

    Args:
        heights: (rows, columns) float32, mm.
        rounding: a ``Rounding``.
        tops: (rows, columns) int32, to fill.
    """
    rows, columns = heights.shape
    shares, weights = rounding.shares, rounding.weights
    steps, down, reach = len(shares), len(weights), weights.shape[1] // 2
    # errors that rows have been passed, in turns: row i is at i % down
    passed = np.zeros((down, columns + 2 * reach), np.float32)
    for i in range(rows):
        ahead = 1 if i % 2 == 0 else -1
        here = passed[i % down]
        for step in range(columns):
            j = step if ahead == 1 else columns - 1 - step
            if heights[i, j] <= 0.0:
                tops[i, j] = 0
                continue
            wanted = heights[i, j] / rounding.layer + here[j + reach]
            whole = max(int(np.floor(wanted)), 0)
            k = np.searchsorted(rounding.between, wanted - whole, side="right")
            tops[i, j] = whole * steps + k
            left = np.float32(wanted - whole - (shares[k] if k < steps else 1.0))
            for a in range(down):
                to = passed[(i + a) % down]
                for b in range(2 * reach + 1):
                    if a > 0 or b > reach:
                        to[j + reach + (b - reach) * ahead] += left * weights[a, b]
        here[:] = 0.0
