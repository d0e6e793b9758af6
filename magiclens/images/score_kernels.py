"""Structural similarity (Wang, Bovik, Sheikh and Simoncelli 2004), compiled."""

from __future__ import annotations

import numpy as np

from magiclens.kernels.compiler import njit

_WINDOW = 7
"""Pixels along the side of the square windows that are compared."""
_C1, _C2 = 0.01**2, 0.03**2
"""What keeps the quotients finite where pictures are black or flat, for values 0 to 1."""


@njit(cache=True, nogil=True)
def structural_similarity(seen, wanted):
    """Mean structural similarity of two pictures over all windows that lie within them.

    Args:
        seen, wanted: (R, C) float64 display values, 0 to 1, at least as large as a window.
    """
    rows, columns = seen.shape
    size = _WINDOW * _WINDOW
    down = np.zeros((columns, 5))  # sums down the columns of the windows: x, y, x^2, y^2, x y
    total = 0.0
    for i in range(rows):
        for j in range(columns):
            x, y = seen[i, j], wanted[i, j]
            u, v = (seen[i - _WINDOW, j], wanted[i - _WINDOW, j]) if i >= _WINDOW else (0.0, 0.0)
            down[j, 0] += x - u
            down[j, 1] += y - v
            down[j, 2] += x * x - u * u
            down[j, 3] += y * y - v * v
            down[j, 4] += x * y - u * v
        if i < _WINDOW - 1:
            continue
        a, b, aa, bb, ab = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(columns):
            a, b, aa, bb, ab = a + down[j, 0], b + down[j, 1], aa + down[j, 2], bb + down[j, 3], ab + down[j, 4]
            if j < _WINDOW - 1:
                continue
            mean_x, mean_y = a / size, b / size
            product, squares = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
            covariance, variances = (ab - size * product) / (size - 1), (aa + bb - size * squares) / (size - 1)
            brightness = (2.0 * product + _C1) / (squares + _C1)
            total += brightness * (2.0 * covariance + _C2) / (variances + _C2)
            k = j - _WINDOW + 1
            a, b, aa, bb, ab = a - down[k, 0], b - down[k, 1], aa - down[k, 2], bb - down[k, 3], ab - down[k, 4]
    return total / ((rows - _WINDOW + 1) * (columns - _WINDOW + 1))
