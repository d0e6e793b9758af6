"""Look-ups of pictures."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit


@njit(cache=True)
def rotated_grid(k, samples):
    """Where in its pixel, from the upper left, the k-th of samples^2 lies: the columns of a square grid, turned."""
    a, b = k % samples, k // samples
    return (a + (b + 0.5) / samples) / samples, (b + (samples - a - 0.5) / samples) / samples


# inlined before typing, so that the callers' own fastmath flags hold, and every caller gets the bits of its own code
@njit(inline="always")
def clamped_cell(x, y, columns, rows):
    """The four pixels around a point of a raster, as column and row of the upper left, and the point's place in them.

    Args:
        x, y: column and row of the point, pixel centres being whole numbers; outside, the nearest point counts.
        columns, rows: of the raster.

    Returns:
        Column, row, and how far the point lies toward the next column and row, from 0 to 1.
    """
    # a thousandth short of the last pixel's centre, so that there is always a next pixel to weigh with
    x, y = min(max(x, 0.0), columns - 1.001), min(max(y, 0.0), rows - 1.001)
    ix, iy = int(x), int(y)
    return ix, iy, x - ix, y - iy


@njit(inline="always")
def blend(upper, lower, fx, fy):
    """Bilinear mean of four values.

    Args:
        upper: the upper two, from left to right.
        lower: the lower two.
        fx, fy: how far right and how far down the point lies, from 0 to 1.
    """
    top, low = upper[0] + (upper[1] - upper[0]) * fx, lower[0] + (lower[1] - lower[0]) * fx
    return top + (low - top) * fy


@njit(inline="always")
def weighted_light(values, columns, channels, row, column, fx, fy, weight):
    """Bilinear mean of an image's pixels, times a weight, as numbers that registers hold; 0 in channels it lacks.

    Args:
        values: of an image, (H, W, C) as (H * W * C,); C is 1 or 3.
        columns: W.
        channels: C.
        row, column: of the upper left of four pixels.
        fx, fy: how far right and how far down of it the point lies, from 0 to 1.
        weight: of the mean.

    Returns:
        Three float32.
    """
    low = weight * fy
    high = weight - low
    right, low_right = high * fx, low * fx
    a, b, c, d = np.float32(high - right), np.float32(right), np.float32(low - low_right), np.float32(low_right)
    upper = (row * columns + column) * channels
    lower = upper + columns * channels
    red = a * values[upper] + b * values[upper + channels] + c * values[lower] + d * values[lower + channels]
    green = blue = np.float32(0)
    if channels == 3:
        green = a * values[upper + 1] + b * values[upper + 4] + c * values[lower + 1] + d * values[lower + 4]
        blue = a * values[upper + 2] + b * values[upper + 5] + c * values[lower + 2] + d * values[lower + 5]
    return red, green, blue


@njit(cache=True, fastmath=True)
def bilinear(image, x, y):
    """Bilinear value of an image between its pixels, and its derivatives.

    Args:
        image: (H, W) float32.
        x, y: column and row; outside, the nearest point of the image counts.

    Returns:
        The value, and its derivatives per pixel along x and y.
    """
    h, w = image.shape
    ix, iy, fx, fy = clamped_cell(x, y, w, h)
    fx, fy = np.float32(fx), np.float32(fy)
    a, b = image[iy, ix], image[iy, ix + 1]
    c, d = image[iy + 1, ix], image[iy + 1, ix + 1]
    top, low = a + (b - a) * fx, c + (d - c) * fx
    return top + (low - top) * fy, (b - a) * (1 - fy) + (d - c) * fy, low - top
