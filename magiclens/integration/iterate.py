"""Orientation and integration, alternated until the surface no longer moves: the outer loop of integrators (4.5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magiclens.contract.artifacts import Assignment, FloatArray, HeightField, Scene
from magiclens.contract.errors import StageError
from magiclens.contract.stages import Progress
from magiclens.integration.levels import excursions
from magiclens.integration.orientation import edge_rises
from magiclens.integration.surface_metrics import surface_metrics

Solve = Callable[[FloatArray, FloatArray, FloatArray, int], FloatArray]
"""From edge rises along rows and columns (see ``edge_rises``), the heights now and the round, to new heights."""

_STUCK_MM = 1e-2
"""A surface that still moves by more than this after the last round has not converged, mm."""


def iterate(
    scene: Scene, assignment: Assignment, solve: Solve, rounds: int, tolerance: float, progress: Progress
) -> HeightField:
    """Alternate orientation and integration until no height moves by more than the tolerance.

    Normals depend on heights only weakly, so the iteration contracts; where a change grows all the same, smaller
    steps are taken.

    Args:
        scene: the lens and its views.
        assignment: what the facets shall show.
        solve: integrates slopes to heights.
        rounds: rounds, at most.
        tolerance: largest change of a height in a round that ends the iteration, mm.
        progress: is told the share of the rounds that are done.

    Returns:
        The height field, with metrics of its surface and of the iteration.

    Raises:
        StageError: heights do not converge, or leave the relief; it names the facet.
    """
    lens = scene.lens
    heights = np.zeros((lens.facets, lens.facets, lens.microfacets + 1, lens.microfacets + 1))
    damping, last = 1.0, np.inf  # damping: share of each change that is made; halved whenever changes grow
    for done in range(rounds):
        rows, columns, clamped = edge_rises(scene, assignment, heights)
        move = solve(rows, columns, heights, done) - heights
        change = float(np.abs(move).max())
        damping = damping if change < last else 0.5 * damping
        heights, last = heights + damping * move, change
        progress((done + 1) / rounds)
        if change < tolerance:
            break
    if change > _STUCK_MM:
        i, j = np.unravel_index(np.abs(move).max(axis=(2, 3)).argmax(), move.shape[:2])
        raise StageError(
            f"heights did not converge: facet (row {i}, column {j}) still moves by {change:.3g} mm; "
            "use a smaller window, a thicker lens or a smaller max_slope",
            keys=("lens.max_slope", "lens.thickness", "pipeline.matcher.window"),
        )
    check_relief(heights, lens.relief_mm)
    built = HeightField(lens, heights, scene.cut_eye_mm)
    metrics = surface_metrics(built) | {
        "integration_rounds": done + 1.0,
        "integration_change_mm": change,
        "facets_at_slope_limit": float((clamped > 0).sum()),
    }
    return replace(built, metrics=metrics)


def check_relief(heights: FloatArray, relief: float) -> None:
    """Refuse heights (N, N, k, k), mm, that leave the reference plane by more than ``relief`` mm.

    Raises:
        StageError: it names the facet that is tallest.
    """
    tallest = excursions(heights)
    if tallest.max() > relief * (1 + 1e-9):  # heights that were clipped to the relief may exceed it by rounding
        i, j = np.unravel_index(tallest.argmax(), tallest.shape)
        raise StageError(
            f"facet (row {i}, column {j}) needs {tallest.max():.2f} mm of relief, more than lens.relief: {relief:g}mm; "
            "use more facets, a smaller window or a larger lens.relief",
            keys=("lens.relief", "lens.facets", "pipeline.matcher.window"),
        )
