"""Rematching (4.6, last paragraph): what the built lens really shows corrects what matching had promised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magiclens.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid, View

RESOLUTION = 16
"""Pixels per facet side of the traced pictures."""


def rematch(scene: Scene, candidates: Candidates, assignment: Assignment, heights: HeightField) -> Candidates:
    """The candidates with the errors of those in use replaced by what the eye sees through the lens as it is now.

    Candidates that steps, walls or the lenslets' true shapes have spoilt then lose against others of their facet.
    The lists stay in the matcher's order, so that a candidate's number means the same in every round.
    """
    from magiclens.meshing.solid import solid_from_heights

    solid = solid_from_heights(heights)
    traced = np.mean([facet_errors(scene, solid, view) for view in scene.views], axis=0)
    errors = candidates.errors.copy()
    i, j = np.indices(assignment.choice.shape)
    errors[i, j, assignment.choice] = traced
    return replace(candidates, errors=errors)


def facet_errors(scene: Scene, solid: Solid, view: View) -> FloatArray:
    """(N, N) mean squared difference, in display values, of each facet's traced picture and its tile; lens frame."""
    from magiclens.images import resize, score, to_display
    from magiclens.rendering.trace import picture, trace

    lens, n = scene.lens, scene.lens.facets
    local = view.in_lens_frame()
    hits = trace(solid, lens, view, n * RESOLUTION, 2)
    seen = picture(hits, local.source, lens.source_size_mm)
    target = resize(local.target, seen.shape[:2])
    difference = to_display(np.clip(seen * score(seen, target).gain, 0, 1)) - to_display(target)
    tiles = (difference**2).mean(axis=-1).reshape(n, RESOLUTION, n, RESOLUTION)
    errors: FloatArray = tiles.mean(axis=(1, 3))
    return errors
