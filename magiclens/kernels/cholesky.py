"""Small symmetric positive definite systems, solved in place."""

from __future__ import annotations

import math

from magiclens.kernels.compiler import njit


@njit(cache=True)
def solve_damped(a, b, n, damping):
    """Solve the damped normal equations of Levenberg and Marquardt in place: b becomes the step, by Cholesky.

    ``(A + damping diag(A) + (1e-9 tr(A) + 1e-9) I) x = b``; what is added beside the damping keeps the matrix positive
    definite where a parameter makes no difference.

    Args:
        a: (>= n, >= n) float64 J^T J, of which the lower half counts, overwritten.
        b: (>= n,) float64 -J^T r, overwritten by x.
        n: how many parameters there are.
        damping: relative to the diagonal.
    """
    trace = 0.0
    for m in range(n):
        trace += a[m, m]
    for m in range(n):
        a[m, m] += damping * a[m, m] + 1e-9 * trace + 1e-9
        for k in range(m + 1):
            rest = a[m, k]
            for i in range(k):
                rest -= a[m, i] * a[k, i]
            a[m, k] = 1.0 / math.sqrt(rest) if k == m else rest * a[k, k]  # of the diagonal, the reciprocal
    for m in range(n):
        for i in range(m):
            b[m] -= a[m, i] * b[i]
        b[m] *= a[m, m]
    for m in range(n - 1, -1, -1):
        for i in range(m + 1, n):
            b[m] -= a[i, m] * b[i]
        b[m] *= a[m, m]
