"""Numbers a fabricator asks for: steps, slopes, extent."""

from __future__ import annotations

import numpy as np

from magiclens.artifacts import FloatArray, Lens


def steps(heights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """|steps| across the walls between horizontal and vertical neighbours, (N, N-1, k) and (N-1, N, k), mm."""
    right = np.abs(heights[:, :-1, :, -1] - heights[:, 1:, :, 0])
    below = np.abs(heights[:-1, :, -1, :] - heights[1:, :, 0, :])
    return right, below


def measures(lens: Lens, heights: FloatArray) -> dict[str, float]:
    """Steps, slopes and extent of a height field (N, N, k, k), mm and degrees."""
    d = (lens.pitch_mm - lens.wall_mm) / lens.microfacets
    gu = np.diff(heights, axis=3)[:, :, :-1, :] / d
    gv = np.diff(heights, axis=2)[:, :, :, :-1] / d
    slopes = np.degrees(np.arctan(np.hypot(gu, gv)))
    jumps = np.concatenate([s.ravel() for s in steps(heights)]) if lens.facets > 1 else np.zeros(1)
    return {
        "step_mean_mm": float(jumps.mean()),
        "step_max_mm": float(jumps.max()),
        "slope_mean_deg": float(slopes.mean()),
        "slope_max_deg": float(slopes.max()),
        "z_min_mm": float(lens.thickness_mm + heights.min()),
        "z_max_mm": float(lens.thickness_mm + heights.max()),
    }
