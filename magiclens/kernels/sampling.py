"""Where a picture's pixels are looked at."""

from __future__ import annotations

from numba import njit


@njit(cache=True)
def place(k, samples):
    """Where in its pixel, from the upper left, the k-th of samples^2 lies: the columns of a square grid, turned."""
    a, b = k % samples, k // samples
    return (a + (b + 0.5) / samples) / samples, (b + (samples - a - 0.5) / samples) / samples
