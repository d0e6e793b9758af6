"""The numerics of the ``poisson`` integrator."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import dct, dctn, idctn

from magiclens.artifacts import Assignment, FloatArray, HeightField, Scene
from magiclens.errors import StageError
from magiclens.integration.measures import measures
from magiclens.integration.orientation import edge_rises
from magiclens.integration.placement import place_for_light
from magiclens.optics.walls import cost_of_lost_light
from magiclens.stages import Progress

if TYPE_CHECKING:
    from magiclens.integration.poisson import Poisson

SETTLING = 3
"""Rounds after which `light` placement keeps its levels: its energy has kinks, at which it would chatter."""


def integrate(options: Poisson, scene: Scene, assignment: Assignment, progress: Progress) -> HeightField:
    """See ``Poisson.integrate``."""
    lens = scene.lens
    n, k = lens.facets, lens.microfacets + 1
    heights = np.zeros((n, n, k, k))
    loss = cost_of_lost_light(scene) / lens.pitch_mm
    damping, last, screening = options.damping, np.inf, options.screening
    for done in range(options.iterations):
        rows, columns, clamped = edge_rises(scene, assignment, heights)
        shapes = lenslets(rows, columns).reshape(n, n, k, k)
        if done < SETTLING or options.placement == "steps":
            levels, screening = place(shapes, screening, lens.relief_mm)
        if done < SETTLING and options.placement == "light":
            levels = place_for_light(scene, assignment, shapes, levels, loss, options.step_weight)
        target = shapes + levels[:, :, None, None]
        change = float(np.abs(target - heights).max())
        # a contraction shrinks the change every time; where it does not, smaller steps make it one
        damping = damping if change < last else 0.5 * damping
        heights, last = heights + damping * (target - heights), change
        progress((done + 1) / options.iterations)
        if change < options.tolerance:
            break
    else:
        if change > 1e-2:
            worst = np.unravel_index(np.abs(target - heights).max(axis=(2, 3)).argmax(), (n, n))
            raise StageError(
                f"heights did not converge: facet (row {worst[0]}, column {worst[1]}) still moves by {change:.3g} mm; "
                "use a smaller window, a thicker lens or a smaller max_slope"
            )
    metrics = measures(lens, heights) | {
        "integration_iterations": done + 1.0,
        "integration_change_mm": change,
        "integration_screening": screening,
        "facets_at_slope_limit": float((clamped > 0).sum()),
    }
    return HeightField(lens, heights, None if lens.cells == "vertical" else scene.reference_eye_mm, metrics)


@cache
def _cosines(k: int) -> tuple[FloatArray, FloatArray]:
    """The orthonormal DCT-II matrix (k, k) and the eigenvalues (k, k) of the k x k grid's Laplacian."""
    matrix = dct(np.eye(k), axis=0, norm="ortho")
    line = 2 - 2 * np.cos(np.pi * np.arange(k) / k)
    return matrix, line[:, None] + line[None, :]


def lenslets(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """(F, k, k) heights of zero mean whose edge rises are nearest, in the least-squares sense, to those asked for.

    rows: (F, k, k - 1), columns: (F, k - 1, k), mm. The normal equations are a Poisson problem on each facet's grid of
    vertices with free edges, which the cosine transform makes diagonal.
    """
    k = rows.shape[1]
    divergence = np.zeros((len(rows), k, k))
    divergence[:, :, 1:] += rows
    divergence[:, :, :-1] -= rows
    divergence[:, 1:, :] += columns
    divergence[:, :-1, :] -= columns
    matrix, eigenvalues = _cosines(k)
    spectrum = matrix @ divergence @ matrix.T
    spectrum /= np.where(eigenvalues > 0, eigenvalues, np.inf)
    return matrix.T @ spectrum @ matrix


def place(shapes: FloatArray, screening: float, relief: float) -> tuple[FloatArray, float]:
    """(N, N) heights of facets at which neighbouring edges meet best, and the screening used.

    shapes: (N, N, k, k) mm, zero mean. Minimises the squared mean mismatch over shared edges plus ``screening`` times
    the squared heights. The screening is raised, where needed, until nothing leaves +-relief.
    """
    n = shapes.shape[0]
    right = (shapes[:, :-1, :, -1] - shapes[:, 1:, :, 0]).mean(axis=-1)
    below = (shapes[:-1, :, -1, :] - shapes[1:, :, 0, :]).mean(axis=-1)
    divergence = np.zeros((n, n))
    divergence[:, 1:] += right
    divergence[:, :-1] -= right
    divergence[1:, :] += below
    divergence[:-1, :] -= below
    spectrum = dctn(divergence, norm="ortho")
    spectrum[0, 0] = 0.0
    eigenvalues = _cosines(n)[1].copy()
    eigenvalues[0, 0] = 1.0
    tallest = np.abs(shapes).max(axis=(2, 3))
    if tallest.max() > relief:
        i, j = np.unravel_index(tallest.argmax(), (n, n))
        raise StageError(
            f"facet (row {i}, column {j}) alone rises {tallest.max():.2f} mm, more than the relief of "
            f"{relief:g} mm: use more facets, a smaller window or a larger lens.relief"
        )
    while True:
        heights = idctn(spectrum / (eigenvalues + screening), norm="ortho")
        if (np.abs(heights) + tallest).max() <= relief:
            return heights, screening
        screening = max(1.3 * screening, 1e-6)
