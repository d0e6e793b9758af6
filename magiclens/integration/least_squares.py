"""The paper's integrator: one over-constrained linear system for all heights (4.5, after Papas et al. 2011)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Integrator, Progress, silent
from magiclens.integration.laplacian import cosines, divergence


class LeastSquaresIntegrator(Integrator):
    """Slopes of every micro-facet and coincidence of every pair of facing vertices, weighed against each other."""

    type: ClassVar[str] = "least-squares"

    continuity: float = Field(
        1.0,
        gt=0,
        le=1e6,
        description="weight of edges meeting, against slopes; large: a continuous surface, as milling wants",
    )
    screening: float = Field(1e-7, ge=0, le=1e6, description="pulls every vertex back to the reference plane")
    rounds: int = Field(12, ge=1, le=1000, description="rounds of orientation and integration, at most")
    tolerance: float = Field(1e-4, gt=0, le=1, description="stop once no height moves by more than this, mm")

    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        """Iterate orientation and integration to convergence."""
        from magiclens.integration.iterate import iterate

        n, k = scene.lens.facets, scene.lens.microfacets + 1
        # all facets as one grid of vertices; every k-th edge crosses a wall
        weights = np.ones(n * k - 1)
        weights[k - 1 :: k] = self.continuity

        def solve(rows: FloatArray, columns: FloatArray, heights: FloatArray, _: int) -> FloatArray:
            # edges across walls ask for no rise: facing vertices shall coincide
            # the padding is the rise 0 of those edges; beyond the last facet there is none, so it is cut off
            wide = _join(np.pad(rows.reshape(n, n, k, k - 1), ((0, 0),) * 3 + ((0, 1),)))[:, :-1]
            tall = _join(np.pad(columns.reshape(n, n, k - 1, k), ((0, 0),) * 2 + ((0, 1), (0, 0))))[:-1]
            right = divergence(weights * wide, weights[:, None] * tall)
            grid = solve_weighted(right, weights, self.screening, _join(heights))
            return grid.reshape(n, k, n, k).transpose(0, 2, 1, 3)

        return iterate(scene, assignment, solve, self.rounds, self.tolerance, progress)


def solve_weighted(right: FloatArray, weights: FloatArray, screening: float, start: FloatArray) -> FloatArray:
    """Solve ``(L + screening) z = right`` on a grid whose Laplacian L has weighted edges.

    By conjugate gradients, preconditioned by the unweighted Laplacian, which the cosine transform inverts; the
    condition number is at most the largest weight over the smallest.

    Args:
        right: (g, g).
        weights: (g - 1,), of the edges between lines i and i + 1 in either direction.
        screening: weight of the squared heights.
        start: (g, g) heights to begin with, mm.

    Returns:
        (g, g) heights z, mm.

    Raises:
        StageError: the iteration does not converge, because the weights differ too much.
    """
    from scipy.fft import dctn, idctn
    from scipy.sparse.linalg import LinearOperator, cg

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
        LinearOperator(shape, apply),
        right.ravel(),
        start.ravel(),  # the heights of the round before, from which they move little
        rtol=1e-7,
        maxiter=400,
        M=LinearOperator(shape, precondition),
    )
    if failed:
        raise StageError("conjugate gradients did not converge: use a smaller continuity", keys=("continuity",))
    heights: FloatArray = solution.reshape(g, g)
    return heights


def _join(parts: FloatArray) -> FloatArray:
    """(N, N, a, b) of facets side by side: (N a, N b)."""
    n, _, a, b = parts.shape
    return parts.transpose(0, 2, 1, 3).reshape(n * a, n * b)
