"""The numerics of the ``least-squares`` integrator: all vertices of the lens in one weighted system."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import dctn, idctn
from scipy.sparse.linalg import LinearOperator, cg

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Progress
from magiclens.integration.iterate import iterate
from magiclens.integration.two_level import cosines, divergence

if TYPE_CHECKING:
    from magiclens.integration.least_squares import LeastSquares


def integrate(options: LeastSquares, scene: Scene, assignment: Assignment, progress: Progress) -> HeightField:
    """See ``LeastSquares.integrate``."""
    n, k = scene.lens.facets, scene.lens.microfacets + 1
    weights = np.ones(n * k - 1)
    weights[k - 1 :: k] = options.continuity

    def solve(rows: FloatArray, columns: FloatArray, heights: FloatArray, _: int) -> FloatArray:
        wide = _join(np.pad(rows.reshape(n, n, k, k - 1), ((0, 0),) * 3 + ((0, 1),)))[:, :-1]
        tall = _join(np.pad(columns.reshape(n, n, k - 1, k), ((0, 0),) * 2 + ((0, 1), (0, 0))))[:-1]
        right = divergence(weights * wide, weights[:, None] * tall)
        grid = solve_weighted(right, weights, options.screening, _join(heights))
        return grid.reshape(n, k, n, k).transpose(0, 2, 1, 3)

    return iterate(scene, assignment, solve, options.rounds, options.tolerance, progress)


def solve_weighted(right: FloatArray, weights: FloatArray, screening: float, start: FloatArray) -> FloatArray:
    """Solve ``(L + screening) z = right`` on a g x g grid whose Laplacian L has the given edge weights.

    weights: (g - 1,), of the edge between lines i and i + 1 in either direction. Conjugate gradients, preconditioned by
    the unweighted Laplacian, which the cosine transform inverts; the condition number is at most the largest weight
    over the smallest.
    """
    g = len(start)
    # the constant part has no slope: only the screening holds it, and it starts at zero
    diagonal = cosines(g)[1] * float(np.sqrt(weights.max() * weights.min())) + max(screening, 1e-12)

    def apply(z: FloatArray) -> FloatArray:
        z = z.reshape(g, g)
        rise = divergence(weights * np.diff(z, axis=1), weights[:, None] * np.diff(z, axis=0))
        out: FloatArray = (rise + screening * z).ravel()
        return out

    def precondition(r: FloatArray) -> FloatArray:
        out: FloatArray = idctn(dctn(r.reshape(g, g), norm="ortho") / diagonal, norm="ortho").ravel()
        return out

    shape = (g * g, g * g)
    solution, failed = cg(
        LinearOperator(shape, apply), right.ravel(), start.ravel(), rtol=1e-7, maxiter=400,
        M=LinearOperator(shape, precondition),
    )
    if failed:
        raise StageError("conjugate gradients did not converge: use a smaller continuity")
    heights: FloatArray = solution.reshape(g, g)
    return heights


def _join(parts: FloatArray) -> FloatArray:
    """(N, N, a, b) of facets side by side: (N a, N b)."""
    n, _, a, b = parts.shape
    return parts.transpose(0, 2, 1, 3).reshape(n * a, n * b)
