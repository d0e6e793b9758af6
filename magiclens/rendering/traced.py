"""What the lens as built shows: errors facet by facet, and the matrices from sources to pictures."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, Scene, Solid, Transport, View

PIXELS = 16
"""Pixels per facet side at which errors are traced."""

LEAST_RESOLUTION, SAMPLES = 512, 5
"""Of the pictures that transport matrices give: pixels per side, and samples per side of a pixel.

No pixel straddles two facets. With fewer samples an encoder paints for the samples instead of the pixels: 3 instead of
5 per side cost path-traced pictures of universal lenses 3 to 8 dB.
"""


def facet_errors(scene: Scene, heights: HeightField) -> FloatArray:
    """(N, N) mean squared difference, in display values, of each facet's traced picture and its tile; mean of views."""
    from magiclens.geometry.solid import solid_from_heights

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
    """One per view; views that share eye, rotation and source raster share the matrix.

    Only the first of views that are ``alike`` is traced.
    """
    from magiclens.rendering.trace import transport

    resolution = scene.lens.facets * math.ceil(LEAST_RESOLUTION / scene.lens.facets)
    made: dict[tuple[str, int], Transport] = {}
    found = []
    for view in scene.views:
        first = alike(scene, view)
        key = first.name, (view.quarter_turns - first.quarter_turns) % 4
        if first is view:
            made[key] = transport(solid, scene.lens, view, resolution, SAMPLES)
        elif key not in made:
            made[key] = made[first.name, 0].turned(key[1])
        found.append(made[key])
    return found


def alike(scene: Scene, view: View) -> View:
    """The scene's first view whose eye is at the same place in the lens frame and whose source has the same raster."""
    return next(other for other in scene.views if _sight(other) == _sight(view))


def _sight(view: View) -> tuple[float, ...]:
    return (*view.eye_in_lens_frame_mm, *view.source.shape[:2])
