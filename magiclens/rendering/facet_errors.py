"""The errors of the lens as built, facet by facet, as the built-in tracer sees them."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, Scene, Solid, View

_PIXELS = 16
"""Number of pixels along a facet's side at which errors are traced."""


def facet_errors(scene: Scene, heights: HeightField) -> FloatArray:
    """(N, N) mean squared difference, in display values, of each facet's traced picture and its tile; mean of views."""
    from magiclens.geometry.solid import solid_from_heights

    solid = solid_from_heights(heights)
    errors: FloatArray = np.mean([view_errors(scene, solid, view) for view in scene.views], axis=0)
    return errors


def view_errors(scene: Scene, solid: Solid, view: View) -> FloatArray:
    """(N, N) errors as of ``facet_errors`` in one view; lens frame."""
    from magiclens.images import resize, score, to_display
    from magiclens.rendering.tracer import picture, trace

    lens, n = scene.lens, scene.lens.facets
    local = view.in_lens_frame()
    hits = trace(solid, lens, view, n * _PIXELS, 2)
    seen = picture(hits, local.source, lens.source_size_mm)
    target = resize(local.target, seen.shape[:2])
    difference = to_display(np.clip(seen * score(seen, target).gain, 0, 1)) - to_display(target)
    tiles = (difference**2).mean(axis=-1).reshape(n, _PIXELS, n, _PIXELS)
    errors: FloatArray = tiles.mean(axis=(1, 3))
    return errors
