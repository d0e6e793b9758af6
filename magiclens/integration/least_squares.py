"""The paper's integrator: one over-constrained linear system for all heights (4.5, after Papas et al. 2011)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene
from magiclens.contract.stages import Integrator, Progress, silent
from magiclens.integration.laplacian import divergence


class LeastSquaresIntegrator(Integrator):
    """Slopes of every micro-facet and coincidence of every pair of facing vertices, weighed against each other."""

    type: ClassVar[str] = "least-squares"
    version: ClassVar[str] = "2"

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

        def solve(rows: FloatArray, columns: FloatArray, _: FloatArray, __: int) -> FloatArray:
            # edges across walls ask for no rise: facing vertices shall coincide
            # the padding is the rise 0 of those edges; beyond the last facet there is none, so it is cut off
            wide = _join(np.pad(rows.reshape(n, n, k, k - 1), ((0, 0),) * 3 + ((0, 1),)))[:, :-1]
            tall = _join(np.pad(columns.reshape(n, n, k - 1, k), ((0, 0),) * 2 + ((0, 1), (0, 0))))[:-1]
            right = divergence(weights * wide, weights[:, None] * tall)
            grid = solve_weighted(right, weights, self.screening)
            return grid.reshape(n, k, n, k).transpose(0, 2, 1, 3)

        return iterate(scene, assignment, solve, self.rounds, self.tolerance, progress)


def solve_weighted(right: FloatArray, weights: FloatArray, screening: float) -> FloatArray:
    """Solve ``(L + screening) z = right`` on a grid whose Laplacian L has weighted edges.

    Weights are the same along both axes, so the Laplacian of the grid is that of a line along one axis plus that along
    the other, and the eigenvectors of the line make it diagonal. With equal weights these are cosines.

    Args:
        right: (g, g).
        weights: (g - 1,), of the edges between lines i and i + 1 in either direction.
        screening: weight of the squared heights.

    Returns:
        (g, g) heights z, mm; of zero mean where nothing else holds their mean.
    """
    from scipy.fft import dctn, idctn
    from scipy.linalg import eigh_tridiagonal

    g = len(right)
    if np.ptp(weights) == 0:
        line = weights[0] * (2 - 2 * np.cos(np.pi * np.arange(g) / g))
        heights: FloatArray = idctn(_divided(dctn(right, norm="ortho"), line, screening), norm="ortho")
        return heights
    ends = np.concatenate([[0.0], weights, [0.0]])
    line, modes = eigh_tridiagonal(ends[:-1] + ends[1:], -weights)
    heights = modes @ _divided(modes.T @ right @ modes, line, screening) @ modes.T
    return heights


def _divided(spectrum: FloatArray, line: FloatArray, screening: float) -> FloatArray:
    """A spectrum divided by the eigenvalues of the grid, those of a line along either axis being ``line``."""
    eigenvalues = line[:, None] + line[None, :] + screening
    # the constant part has no slope: only the screening holds it
    eigenvalues[0, 0] = screening or np.inf
    divided: FloatArray = spectrum / eigenvalues
    return divided


def _join(parts: FloatArray) -> FloatArray:
    """(N, N, a, b) of facets side by side: (N a, N b)."""
    n, _, a, b = parts.shape
    return parts.transpose(0, 2, 1, 3).reshape(n * a, n * b)
