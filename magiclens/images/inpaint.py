"""Filling the gaps of a picture smoothly from what is known around them (paper section 5.2).

The fill is harmonic: every unknown pixel is the mean of its four neighbours. It is found from coarse to fine,
with a few sweeps of successive over-relaxation at each size.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from magiclens.images.colour import FloatArray, to_display, to_linear

BoolArray = NDArray[np.bool_]

SWEEPS = 32
OVER_RELAXATION = 1.8


def inpaint(linear: FloatArray, known: BoolArray) -> FloatArray:
    """(H, W, C) linear light: the image with its unknown pixels filled smoothly, in display values.

    ``known`` is (H, W); known pixels come back unchanged, what unknown ones hold is ignored. Raises ValueError if
    nothing is known.
    """
    if not known.any():
        raise ValueError("no pixel of the picture is known")
    values = to_display(np.where(known[..., None], linear, 0)).astype(np.float32)
    filled = _filled(values, known.astype(np.float32))
    out = linear.copy()
    out[~known] = to_linear(filled[~known])
    return out


def halved(image: FloatArray) -> FloatArray:
    """(ceil(H / 2), ceil(W / 2), ...): means of 2 x 2 pixels; the last row or column stands twice if H or W is odd."""
    rows, columns = image.shape[:2]
    even = np.pad(image, ((0, rows % 2), (0, columns % 2), *((0, 0),) * (image.ndim - 2)), mode="edge")
    return np.asarray((even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4, image.dtype)


def _filled(values: FloatArray, share: FloatArray) -> FloatArray:
    """(H, W, C) filled; ``share`` (H, W) is how much of a pixel is known, ``values`` (H, W, C) is multiplied by it."""
    known = share > 0
    picture = values / np.where(known, share, 1)[..., None]
    if not known.all():
        _enlarge(_filled(halved(values), halved(share)), known, picture)
        _relax(picture, known, np.float32(OVER_RELAXATION))
    return picture


@njit(cache=True)
def _enlarge(coarse, known, picture):
    """Unknown pixels of the picture become the bilinear enlargement of the picture of half its size."""
    rows, columns, channels = picture.shape
    for y in range(rows):
        near_y = y // 2
        far_y = min(max(near_y + (1 if y % 2 else -1), 0), len(coarse) - 1)
        for x in range(columns):
            if known[y, x]:
                continue
            near_x = x // 2
            far_x = min(max(near_x + (1 if x % 2 else -1), 0), coarse.shape[1] - 1)
            for c in range(channels):
                sides = coarse[far_y, near_x, c] + coarse[near_y, far_x, c]
                picture[y, x, c] = (9 * coarse[near_y, near_x, c] + 3 * sides + coarse[far_y, far_x, c]) / 16


@njit(cache=True)
def _relax(picture, known, factor):
    """Move unknown pixels toward the mean of their neighbours, in checkerboard order; the border is mirrored."""
    rows, columns, channels = picture.shape
    for sweep in range(2 * SWEEPS):
        for y in range(rows):
            up, down = max(y - 1, 0), min(y + 1, rows - 1)
            for x in range((y + sweep) % 2, columns, 2):
                if known[y, x]:
                    continue
                left, right = max(x - 1, 0), min(x + 1, columns - 1)
                for c in range(channels):
                    around = picture[up, x, c] + picture[down, x, c] + picture[y, left, c] + picture[y, right, c]
                    picture[y, x, c] += factor * (np.float32(0.25) * around - picture[y, x, c])
