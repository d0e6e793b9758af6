"""The levels of whole facets: heights at which neighbouring edges meet best, or walls take the least light."""

from __future__ import annotations

import numpy as np
from scipy.fft import dctn, idctn

from magiclens.contract.artifacts import FloatArray, Scene
from magiclens.geometry.facets import built_drifts, cost_of_lost_light
from magiclens.integration.laplacian import cosines, divergence
from magiclens.optics.walls import DOWN, LEFT, RIGHT, UP, Edges, EnergyTerms, settle_levels

_TURNS = 10
"""Turns of the descent on the cost of walls."""
_SCREENING = 1e-5
"""Pull of a facet toward the reference plane, per mm^2, where walls leave its level open."""
_MOST_SCREENING = 1e9
"""Screening at which facets count as immovable."""


def levels_of_least_steps(shapes: FloatArray, screening: float, relief: float) -> tuple[FloatArray, float]:
    """Levels at which neighbouring edges meet best, and the screening used (4.5).

    They minimise the squared mean mismatch over shared edges plus ``screening`` times the squared levels. The screening
    is raised, where needed, until no facet leaves the relief.

    Args:
        shapes: (N, N, k, k) mm, zero mean, each within +-relief.
        screening: pull toward the reference plane, to begin with.
        relief: largest distance of any vertex from the reference plane, mm.

    Returns:
        (N, N) levels, mm, and the screening at which all facets stay within the relief.
    """
    right = (shapes[:, :-1, :, -1] - shapes[:, 1:, :, 0]).mean(axis=-1)
    below = (shapes[:-1, :, -1, :] - shapes[1:, :, 0, :]).mean(axis=-1)
    spectrum = dctn(divergence(right, below), norm="ortho")
    spectrum[0, 0] = 0.0  # edges do not say how high the lens is as a whole: its mean level is 0
    eigenvalues = cosines(len(shapes))[1].copy()
    eigenvalues[0, 0] = 1.0
    tallest = excursions(shapes)
    while True:
        levels = idctn(spectrum / (eigenvalues + screening), norm="ortho")
        if (np.abs(levels) + tallest).max() <= relief:
            return levels, screening
        if screening > _MOST_SCREENING:
            return np.zeros_like(levels), screening
        screening = max(1.3 * screening, 1e-6)  # a screening of 0 would never grow


def levels_of_least_lost_light(scene: Scene, shapes: FloatArray, levels: FloatArray, step_weight: float) -> FloatArray:
    """Levels at which walls take the least light, by coordinate descent on a convex energy (see ``optics.walls``).

    Args:
        scene: the lens and its views.
        shapes: (N, N, k, k) mm, zero mean.
        levels: (N, N) to begin with, mm.
        step_weight: cost of a squared step per facet edge, per mm^2.

    Returns:
        (N, N) levels, mm. No facet that fits leaves the relief.
    """
    lens = scene.lens
    edges = Edges(_edge_profiles(shapes), built_drifts(scene, shapes))
    levels = levels.copy()
    terms = EnergyTerms(cost_of_lost_light(scene), lens.pitch_mm, float(step_weight), _SCREENING)
    for turn in range(_TURNS):
        settle_levels(levels, edges, terms, lens.relief_mm, turn)
    return within_relief(shapes, levels, lens.relief_mm)


def within_relief(shapes: FloatArray, levels: FloatArray, relief: float) -> FloatArray:
    """The levels nearest to given ones at which shapes stay within the relief.

    Args:
        shapes: (N, N, k, k) mm, zero mean.
        levels: (N, N) mm.
        relief: largest distance of any vertex from the reference plane, mm.

    Returns:
        (N, N) levels, mm; 0 for a shape that is taller than the relief at any level.
    """
    room = np.maximum(relief - excursions(shapes), 0.0)
    held: FloatArray = np.clip(levels, -room, room)
    return held


def excursions(heights: FloatArray, rise: FloatArray | float = 0.0) -> FloatArray:
    """Largest distances of facets' vertices from the reference plane.

    Args:
        heights: (..., k, k) mm.
        rise: (...) mm, by which whole facets are raised first.

    Returns:
        (...) mm.
    """
    # without a copy of all heights
    largest: FloatArray = np.maximum(heights.max(axis=(-2, -1)) + rise, -(heights.min(axis=(-2, -1)) + rise))
    return largest


def _edge_profiles(shapes: FloatArray) -> FloatArray:
    """(N, N, 4, k) float32: the edges of shapes (N, N, k, k), vertex by vertex, as in ``optics.walls``."""
    edges = np.zeros((*shapes.shape[:2], 4, shapes.shape[2]), np.float32)
    # points of upright edges run along +y, rows the other way
    edges[:, :, RIGHT], edges[:, :, LEFT] = shapes[:, :, ::-1, -1], shapes[:, :, ::-1, 0]
    edges[:, :, UP], edges[:, :, DOWN] = shapes[:, :, 0, :], shapes[:, :, -1, :]
    return edges
