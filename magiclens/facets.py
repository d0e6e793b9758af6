"""A scene's facets before they are built: what candidates would need of the surface, and what lost light costs."""

from __future__ import annotations

import numpy as np

from magiclens.artifacts import FloatArray, Scene
from magiclens.images import to_display

EDGE_POINTS = 4
"""Points per facet edge at which steps are measured."""


def edge_models(scene: Scene, offsets: FloatArray, maps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Edge profiles (N, N, K, 4, Q) float32, mm, of zero-mean lenslets, and outward drifts (N, N, K, 4) float32.

    offsets: (N, N, K, 2) mm and maps: (N, N, K, 3), as in ``artifacts.Candidates``. See ``optics.walls``.
    """
    from magiclens.optics import lenslets

    lens, n = scene.lens, scene.lens.facets
    eyes = np.stack([view.in_lens_frame().eye_mm for view in scene.views])
    profiles, drifts = lenslets.edge_models(
        lens.facet_centres_mm().reshape(-1, 2), *_flat(n, offsets, maps), scene.reference_eye_mm,
        np.unique(eyes.round(9), axis=0), lens.cells == "vertical", lens.pitch_mm,
        lens.thickness_mm, lens.gap_mm, lens.ior, EDGE_POINTS,
    )
    return profiles.reshape(*offsets.shape[:3], 4, EDGE_POINTS), drifts.reshape(*offsets.shape[:3], 4)


def central_slopes(scene: Scene, offsets: FloatArray) -> FloatArray:
    """(N, N, K, 2) dz/dx and dz/dy at the facets' centres that show the patches at ``offsets`` (N, N, K, 2) mm."""
    from magiclens.optics import lenslets

    lens, n = scene.lens, scene.lens.facets
    slopes: FloatArray = lenslets.centre_slopes(
        lens.facet_centres_mm().reshape(-1, 2), *_flat(n, offsets, np.ones((*offsets.shape[:3], 3))),
        scene.reference_eye_mm, lens.thickness_mm, lens.gap_mm, lens.ior,
    )
    return slopes.reshape(offsets.shape)


def cost_of_lost_light(scene: Scene) -> float:
    """Mean squared difference, in display values, of a target pixel and a random pixel of the source."""
    total = 0.0
    for view in scene.views:
        s, t = to_display(view.source), to_display(view.target)
        total += float((s**2).mean() - 2 * s.mean() * t.mean() + (t**2).mean())
    return total / len(scene.views)


def _flat(n: int, offsets: FloatArray, maps: FloatArray) -> tuple[FloatArray, FloatArray]:
    return offsets.reshape(n * n, -1, 2).astype(np.float64), maps.reshape(n * n, -1, 3).astype(np.float64)
