"""Integration: heights from rises, a sparse linear system, by the solver of the ``least-squares`` integrator."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from benchmarks.comparison import Comparison, Work, installed, require
from magiclens.contract.artifacts import FloatArray

_SCREENING = 1e-4


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """A general sparse solver at a size that it can hold; others at that of 64 x 64 facets, even and with walls."""
    small, large = (48, 64) if options.quick else (352, 1408)
    even, walls = ("CHOLMOD", "pyamg"), ("pyamg",)
    return [_comparison(*case) for case in ((("SciPy spsolve",), small, 1.0), (even, large, 1.0), (walls, large, 20.0))]


def _comparison(names: tuple[str, ...], side: int, continuity: float) -> Comparison:
    from magiclens.integration.least_squares import solve_weighted

    rng, weights = np.random.default_rng(0), np.ones(side - 1)
    weights[22::23] = continuity
    right = rng.normal(size=(side, side))
    right -= right.mean()
    matrix = _matrix(weights, side)
    ours = lambda: solve_weighted(right, weights, _SCREENING)  # noqa: E731
    walls = "" if continuity == 1.0 else f", edges across walls {continuity:g} times as heavy"

    def agreement(mine: FloatArray, theirs: FloatArray) -> str:
        size = np.linalg.norm(right)
        left = [float(np.linalg.norm(matrix @ z.ravel() - right.ravel()) / size) for z in (mine, theirs)]
        return require(max(left) < 2e-6, f"residual {left[0]:.0e}, {left[1]:.0e}")

    here = {name: solver for name, (package, solver) in _PEERS.items() if name in names and installed(package)}
    peers = {name: solver(matrix, right) for name, solver in here.items()}
    missing = tuple(name for name in names if name not in here)
    return Comparison("integration", f"{side}² vertices{walls}", ours, peers, agreement, missing)


def _matrix(weights: FloatArray, side: int) -> Any:
    """The Laplacian with weighted edges and screening, as a sparse matrix."""
    from scipy.sparse import diags_array, eye_array, kron

    line = np.concatenate([[0.0], weights, [0.0]])
    one = diags_array([line[:-1] + line[1:], -weights, -weights], offsets=[0, 1, -1])
    flat = eye_array(side)
    return (kron(one, flat) + kron(flat, one) + _SCREENING * eye_array(side * side)).tocsc()


def _direct(matrix: Any, right: FloatArray) -> Work:
    from scipy.sparse.linalg import spsolve

    return lambda: spsolve(matrix, right.ravel())


def _cholesky(matrix: Any, right: FloatArray) -> Work:
    """Ordering and factors are part of the work, as the matrix is new."""
    from cvxopt import cholmod, spmatrix
    from cvxopt import matrix as column
    from scipy.sparse import tril

    low = tril(matrix).tocoo()
    lower = spmatrix(low.data, low.row, low.col, low.shape)

    def solve() -> FloatArray:
        heights = column(right.ravel())
        cholmod.linsolve(lower, heights)
        return np.array(heights)

    return solve


def _multigrid(matrix: Any, right: FloatArray) -> Work:
    """Ruge and Stueben's, with conjugate gradients around it; setting up is part of the work, as the matrix is new."""
    import pyamg

    rows = matrix.tocsr()
    return lambda: pyamg.ruge_stuben_solver(rows).solve(right.ravel(), tol=1e-7, accel="cg")


_PEERS = {
    "SciPy spsolve": ("scipy", _direct), "CHOLMOD": ("cvxopt", _cholesky), "pyamg": ("pyamg", _multigrid),
}  # fmt: skip
"""The package of each solver, and what makes its work."""
