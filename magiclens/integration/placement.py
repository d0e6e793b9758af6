"""Heights of whole facets at which the walls between them take the least light."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, Scene
from magiclens.geometry.facets import built_drifts, cost_of_lost_light
from magiclens.optics.walls import DOWN, LEFT, RIGHT, UP, sweep

SWEEPS = 60
SCREENING = 1e-5


def edge_profiles(shapes: FloatArray) -> FloatArray:
    """(N, N, 1, 4, k) float32: the edges of shapes (N, N, k, k), vertex by vertex, as in ``optics.walls``."""
    edges = np.zeros((*shapes.shape[:2], 1, 4, shapes.shape[2]), np.float32)
    edges[:, :, 0, RIGHT], edges[:, :, 0, LEFT] = shapes[:, :, ::-1, -1], shapes[:, :, ::-1, 0]
    edges[:, :, 0, UP], edges[:, :, 0, DOWN] = shapes[:, :, 0, :], shapes[:, :, -1, :]
    return edges


def place_for_light(scene: Scene, shapes: FloatArray, levels: FloatArray, even: float) -> FloatArray:
    """(N, N) heights of facets that lose least light, by coordinate descent on a convex energy from ``levels``.

    shapes: (N, N, k, k) mm, zero mean. even: see ``optics.walls.settle``. No facet that fits leaves the relief.
    """
    lens, n = scene.lens, scene.lens.facets
    drifts = built_drifts(scene, shapes)[:, :, None]
    profiles, loss = edge_profiles(shapes), cost_of_lost_light(scene)
    levels, choice, nothing = levels.copy(), np.zeros((n, n), np.int64), np.zeros((n, n))
    weights = loss, lens.pitch_mm, even, SCREENING, lens.relief_mm
    for _ in range(SWEEPS):
        if sweep(choice, levels, nothing[..., None], profiles, drifts, *weights, 0.0, nothing) < 1e-4:
            break
    return within(shapes, levels, lens.relief_mm)


def within(shapes: FloatArray, levels: FloatArray, relief: float) -> FloatArray:
    """(N, N) the heights nearest to ``levels`` at which shapes (N, N, k, k) stay within +-relief; 0 if none does."""
    room = np.maximum(relief - np.abs(shapes).max(axis=(2, 3)), 0.0)
    held: FloatArray = np.clip(levels, -room, room)
    return held
