"""Kernels of harmonic inpainting."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit

_SWEEPS = 32
"""Sweeps of relaxation at each size; each sweep updates both colours of the checkerboard once."""


@njit(cache=True)
def enlarge_unknown(coarse, known, picture):
    """Set the unknown pixels of a picture to the bilinear enlargement of a picture of half its size.

    A pixel's centre lies a quarter of a coarse pixel from the nearest coarse centre, in both directions, so the four
    coarse neighbours weigh 9/16, 3/16, 3/16 and 1/16.

    Args:
        coarse: (ceil(H / 2), ceil(W / 2), C) float32.
        known: (H, W) bool.
        picture: (H, W, C) float32, changed in place.
    """
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
def relax_unknown(picture, known, factor):
    """Move the unknown pixels of a picture toward the mean of their four neighbours: successive over-relaxation.

    ``p += factor * (mean of p's neighbours - p)``, in checkerboard order, so that the neighbours of a pixel are all up
    to date or all old; at the border the picture is continued by its last row or column.

    Args:
        picture: (H, W, C) float32, changed in place.
        known: (H, W) bool.
        factor: float32, between 1 and 2.
    """
    rows, columns, channels = picture.shape
    for sweep in range(2 * _SWEEPS):
        for y in range(rows):
            up, down = max(y - 1, 0), min(y + 1, rows - 1)
            for x in range((y + sweep) % 2, columns, 2):
                if known[y, x]:
                    continue
                left, right = max(x - 1, 0), min(x + 1, columns - 1)
                for c in range(channels):
                    around = picture[up, x, c] + picture[down, x, c] + picture[y, left, c] + picture[y, right, c]
                    picture[y, x, c] += factor * (np.float32(0.25) * around - picture[y, x, c])
