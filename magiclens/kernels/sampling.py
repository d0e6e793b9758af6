"""Look-ups of pictures."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def rotated_grid(k, samples):
    """Where in its pixel, from the upper left, the k-th of samples^2 lies: the columns of a square grid, turned."""
    a, b = k % samples, k // samples
    return (a + (b + 0.5) / samples) / samples, (b + (samples - a - 0.5) / samples) / samples


@njit(cache=True, fastmath=True)
def bilinear(image, x, y):
    """Bilinear value of an image (H, W) and its derivatives per pixel at column x and row y, clamped to the image."""
    h, w = image.shape
    x = min(max(x, 0.0), w - 1.001)
    y = min(max(y, 0.0), h - 1.001)
    ix, iy = int(x), int(y)
    fx, fy = np.float32(x - ix), np.float32(y - iy)
    a, b = image[iy, ix], image[iy, ix + 1]
    c, d = image[iy + 1, ix], image[iy + 1, ix + 1]
    top, low = a + (b - a) * fx, c + (d - c) * fx
    return top + (low - top) * fy, (b - a) * (1 - fy) + (d - c) * fy, low - top
