"""What the lens as built shows: errors facet by facet, and the matrices from sources to pictures."""

from __future__ import annotations

import math

import numpy as np

from magiclens.artifacts import FloatArray, HeightField, Scene, Solid, Transport, View

PIXELS = 16
"""Pixels per facet side at which errors are traced."""

LEAST_RESOLUTION, SAMPLES = 512, 5
"""Of the pictures that transport matrices give: pixels per side, and samples per side of a pixel.

No pixel straddles two facets. With fewer samples an encoder paints for the samples instead of the pixels: 3 instead of
5 per side cost path-traced pictures of universal lenses 3 to 8 dB.
"""


def facet_errors(scene: Scene, heights: HeightField) -> FloatArray:
    """(N, N) mean squared difference, in display values, of each facet's traced picture and its tile; mean of views."""
    from magiclens.meshing.solid import solid_from_heights

    solid = solid_from_heights(heights)
    errors: FloatArray = np.mean([view_errors(scene, solid, view) for view in scene.views], axis=0)
    return errors


def view_errors(scene: Scene, solid: Solid, view: View) -> FloatArray:
    """(N, N) errors as of ``facet_errors`` in one view; lens frame."""
    from magiclens.images import resize, score, to_display
    from magiclens.rendering.trace import picture, trace

    lens, n = scene.lens, scene.lens.facets
    local = view.in_lens_frame()
    hits = trace(solid, lens, view, n * PIXELS, 2)
    seen = picture(hits, local.source, lens.source_size_mm)
    target = resize(local.target, seen.shape[:2])
    difference = to_display(np.clip(seen * score(seen, target).gain, 0, 1)) - to_display(target)
    tiles = (difference**2).mean(axis=-1).reshape(n, PIXELS, n, PIXELS)
    errors: FloatArray = tiles.mean(axis=(1, 3))
    return errors


def transports(scene: Scene, solid: Solid) -> list[Transport]:
    """One per view; views that share eye, rotation and source raster share the matrix."""
    from magiclens.rendering.trace import carried, trace

    resolution = scene.lens.facets * math.ceil(LEAST_RESOLUTION / scene.lens.facets)
    hits: dict[tuple[float, ...], FloatArray] = {}
    made: dict[tuple[object, ...], Transport] = {}
    for view in scene.views:
        eye = tuple(view.in_lens_frame().eye_mm.tolist())
        if eye not in hits:
            hits = {eye: trace(solid, scene.lens, view, resolution, SAMPLES)}
        if _pose(view) not in made:
            made[_pose(view)] = carried(hits[eye], scene.lens, view)
    return [made[_pose(view)] for view in scene.views]


def _pose(view: View) -> tuple[object, ...]:
    return (*view.eye_mm, view.quarter_turns, *view.source.shape[:2])
