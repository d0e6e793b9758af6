"""Heights of whole facets at which the walls between them take the least light."""

from __future__ import annotations

import numpy as np

from magiclens.artifacts import Assignment, FloatArray, Scene
from magiclens.facets import EDGE_POINTS, edge_models
from magiclens.optics.walls import DOWN, LEFT, RIGHT, UP, sweep

SWEEPS = 60


def edge_profiles(shapes: FloatArray) -> FloatArray:
    """(N, N, 1, 4, Q) float32: the edges of shapes (N, N, k, k), interpolated at Q points, as in ``optics.walls``."""
    edges = np.zeros((*shapes.shape[:2], 4, shapes.shape[2]))
    edges[:, :, RIGHT], edges[:, :, LEFT] = shapes[:, :, ::-1, -1], shapes[:, :, ::-1, 0]
    edges[:, :, UP], edges[:, :, DOWN] = shapes[:, :, 0, :], shapes[:, :, -1, :]
    k = shapes.shape[2]
    at = (np.arange(EDGE_POINTS) + 0.5) / EDGE_POINTS * (k - 1)
    weights = np.maximum(1 - np.abs(np.arange(k)[:, None] - at), 0)
    profiles: FloatArray = (edges @ weights)[:, :, None].astype(np.float32)
    return profiles


def place_for_light(
    scene: Scene, assignment: Assignment, shapes: FloatArray, levels: FloatArray,
    loss: float, even: float, relief: float,
) -> FloatArray:
    """(N, N) heights of facets that lose least light, by coordinate descent on a convex energy from ``levels``.

    shapes: (N, N, k, k) mm, zero mean. loss, even: see ``optics.walls.settle``. No edge leaves +-relief.
    """
    n = scene.lens.facets
    _, drifts = edge_models(scene, assignment.offsets_mm[:, :, None], assignment.maps[:, :, None])
    profiles = edge_profiles(shapes)
    levels, choice, nothing = levels.copy(), np.zeros((n, n), np.int64), np.zeros((n, n))
    for _ in range(SWEEPS):
        moved = sweep(choice, levels, nothing[..., None], profiles, drifts, loss, even, 1e-5, relief, 0.0, nothing)
        if moved < 1e-4:
            break
    return levels
