"""Heights in whole layers: how a slicer rounds, and how error diffusion does."""

from __future__ import annotations

from typing import Literal

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray

Slicing = Literal["plain", "diffused"]
"""``plain`` rounds every column of pixels by itself, as slicers do; ``diffused`` passes errors on to its neighbours."""


def layers_of(heights: FloatArray, layer_mm: float, slicing: Slicing) -> IntArray:
    """How many layers each column of pixels gets.

    Plain rounding turns a gentle slope into stairs, which are wide, so that no finish evens them out. Error diffusion
    (R. W. Floyd and L. Steinberg, "An adaptive algorithm for spatial greyscale", Proc. SID 17, 1976) gives columns of
    either number of layers in turns: the mean is right everywhere, and what is wrong is as fine as the pixels.

    Args:
        heights: (rows, columns) of the columns, mm.
        layer_mm: height of a layer.
        slicing: how heights are rounded.

    Returns:
        (rows, columns) int32.
    """
    if slicing == "plain":
        return np.rint(np.asarray(heights, np.float64) / layer_mm).astype(np.int32)
    from magiclens.processes.layers_kernels import diffuse_errors

    count = np.zeros(heights.shape, np.int32)
    diffuse_errors(np.asarray(heights, np.float32), float(layer_mm), count)
    return count
