"""The errors of the lens as built, facet by facet, as the built-in tracer sees them."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, Scene, Solid, View
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import resize, score, to_display
from magiclens.rendering.tracer import picture, trace

_PIXELS = 16
"""Number of pixels along a facet's side at which errors are traced."""


def facet_errors(scene: Scene, heights: HeightField) -> FloatArray:
    """How much what each facet shows, walls and neighbours included, differs from its tile; the mean of all views.

    Args:
        scene: the lens and its views.
        heights: of the lens as built.

    Returns:
        (N, N) mean squared differences, in display values, lens frame.
    """
    solid = solid_from_heights(heights)
    errors: FloatArray = np.mean([_view_errors(scene, solid, view) for view in scene.views], axis=0)
    return errors


def _view_errors(scene: Scene, solid: Solid, view: View) -> FloatArray:
    """(N, N) errors as of ``facet_errors`` of a solid in one view; the exposure makes up for reflection losses."""
    lens, n = scene.lens, scene.lens.facets
    local = view.in_lens_frame()
    hits = trace(solid, lens, view, n * _PIXELS, 2)
    seen = picture(hits, local.source, lens.source_size_mm)
    target = resize(local.target, seen.shape[:2])
    difference = to_display(np.clip(seen * score(seen, target).gain, 0, 1)) - to_display(target)
    tiles = (difference**2).mean(axis=-1).reshape(n, _PIXELS, n, _PIXELS)
    errors: FloatArray = tiles.mean(axis=(1, 3))
    return errors
