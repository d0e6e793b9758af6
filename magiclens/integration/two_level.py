"""The numerics of the ``poisson`` integrator: lenslets inside facets, then the heights of whole facets."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import dct, dctn, idctn

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene
from magiclens.contract.stages import Progress
from magiclens.integration.continuity import limit_steps
from magiclens.integration.iterate import check_relief, iterate
from magiclens.integration.measures import measures
from magiclens.integration.placement import place_for_light, within

if TYPE_CHECKING:
    from magiclens.integration.poisson import Poisson

SETTLING = 3
"""Rounds after which `light` placement keeps its levels: its energy has kinks, at which it would chatter."""


def integrate(options: Poisson, scene: Scene, assignment: Assignment, progress: Progress) -> HeightField:
    """See ``Poisson.integrate``."""
    n, k = scene.lens.facets, scene.lens.microfacets + 1
    relief = scene.lens.relief_mm
    levels: FloatArray = np.zeros((n, n))
    screening = options.screening

    def solve(rows: FloatArray, columns: FloatArray, _: FloatArray, done: int) -> FloatArray:
        nonlocal levels, screening
        shapes = lenslets(rows, columns).reshape(n, n, k, k)
        check_relief(shapes, relief)
        if options.placement == "steps" or done < SETTLING:
            levels, screening = place(shapes, screening, relief)
        if options.placement == "light" and done < SETTLING:
            levels = place_for_light(scene, shapes, levels, options.step_weight)
        return shapes + within(shapes, levels, relief)[:, :, None, None]

    built = iterate(scene, assignment, solve, options.rounds, options.tolerance, progress)
    return built if options.step_limit is None else _without_cliffs(built, options.step_limit)


def _without_cliffs(built: HeightField, limit: float) -> HeightField:
    flatter = replace(built, heights_mm=limit_steps(built.heights_mm, limit))
    return replace(flatter, metrics={**built.metrics, **measures(flatter)})


@cache
def cosines(k: int) -> tuple[FloatArray, FloatArray]:
    """The orthonormal DCT-II matrix (k, k) and the eigenvalues (k, k) of the k x k grid's Laplacian."""
    matrix = dct(np.eye(k), axis=0, norm="ortho")
    line = 2 - 2 * np.cos(np.pi * np.arange(k) / k)
    return matrix, line[:, None] + line[None, :]


def divergence(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """(..., k, k) right side of the normal equations of rises (..., k, k - 1) and (..., k - 1, k)."""
    out = np.zeros((*rows.shape[:-1], rows.shape[-1] + 1))
    out[..., :, 1:] += rows
    out[..., :, :-1] -= rows
    out[..., 1:, :] += columns
    out[..., :-1, :] -= columns
    return out


def lenslets(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """(F, k, k) heights of zero mean whose edge rises are nearest, in the least-squares sense, to those asked for.

    rows: (F, k, k - 1), columns: (F, k - 1, k), mm. The normal equations are a Poisson problem on each facet's grid of
    vertices with free edges, which the cosine transform makes diagonal.
    """
    matrix, eigenvalues = cosines(rows.shape[1])
    spectrum = matrix @ divergence(rows, columns) @ matrix.T
    spectrum /= np.where(eigenvalues > 0, eigenvalues, np.inf)
    return matrix.T @ spectrum @ matrix


def place(shapes: FloatArray, screening: float, relief: float) -> tuple[FloatArray, float]:
    """(N, N) heights of facets at which neighbouring edges meet best, and the screening used.

    shapes: (N, N, k, k) mm, zero mean, each within +-relief. Minimises the squared mean mismatch over shared edges plus
    ``screening`` times the squared heights. The screening is raised, where needed, until nothing leaves +-relief.
    """
    right = (shapes[:, :-1, :, -1] - shapes[:, 1:, :, 0]).mean(axis=-1)
    below = (shapes[:-1, :, -1, :] - shapes[1:, :, 0, :]).mean(axis=-1)
    spectrum = dctn(divergence(right, below), norm="ortho")
    spectrum[0, 0] = 0.0
    eigenvalues = cosines(len(shapes))[1].copy()
    eigenvalues[0, 0] = 1.0
    tallest = np.abs(shapes).max(axis=(2, 3))
    while True:
        heights = idctn(spectrum / (eigenvalues + screening), norm="ortho")
        if (np.abs(heights) + tallest).max() <= relief:
            return heights, screening
        if screening > 1e9:
            return np.zeros_like(heights), screening
        screening = max(1.3 * screening, 1e-6)
