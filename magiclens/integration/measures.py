"""Numbers a fabricator asks for: steps, slopes, extent."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField


def steps(heights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """|steps| across the walls between horizontal and vertical neighbours, (N, N-1, k) and (N-1, N, k), mm."""
    right = np.abs(heights[:, :-1, :, -1] - heights[:, 1:, :, 0])
    below = np.abs(heights[:-1, :, -1, :] - heights[1:, :, 0, :])
    return right, below


def slopes_deg(points: FloatArray) -> FloatArray:
    """Angles between +z and the normals of all triangles of facets (N, N, k, k, 3), degrees; see ``Solid.grid``."""
    right, down = np.diff(points, axis=3), np.diff(points, axis=2)
    pairs = ((right[:, :, 1:], down[..., :-1, :]), (right[:, :, :-1], down[..., 1:, :]))
    normals = np.concatenate([np.cross(d, r).reshape(-1, 3) for r, d in pairs])
    angles: FloatArray = np.degrees(np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), normals[:, 2]))
    return angles


def measures(built: HeightField) -> dict[str, float]:
    """Steps, slopes and extent of a height field, mm and degrees."""
    jumps = np.concatenate([s.ravel() for s in steps(built.heights_mm)]) if built.lens.facets > 1 else np.zeros(1)
    points = built.facet_points_mm()
    slopes = slopes_deg(points)
    return {
        "step_mean_mm": float(jumps.mean()),
        "step_max_mm": float(jumps.max()),
        "slope_mean_deg": float(slopes.mean()),
        "slope_max_deg": float(slopes.max()),
        "z_min_mm": float(points[..., 2].min()),
        "z_max_mm": float(points[..., 2].max()),
    }
