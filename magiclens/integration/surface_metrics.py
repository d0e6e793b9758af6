"""Numbers that fabricators ask of a surface: steps, slopes, extent."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField


def wall_steps(heights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sizes of the steps across the walls between facets.

    Args:
        heights: (N, N, k, k) mm.

    Returns:
        Steps between horizontal neighbours (N, N - 1, k), and between vertical ones (N - 1, N, k), mm, at least 0.
    """
    right = np.abs(heights[:, :-1, :, -1] - heights[:, 1:, :, 0])
    below = np.abs(heights[:-1, :, -1, :] - heights[1:, :, 0, :])
    return right, below


def facet_slopes_deg(points: FloatArray) -> FloatArray:
    """Slopes of all triangles of the facets; each cell is cut from its top-left to its bottom-right corner.

    Args:
        points: (N, N, k, k, 3) vertices of the facets, mm.

    Returns:
        (2 (k - 1)^2 N^2,) angles between +z and the triangles' normals, degrees.
    """
    m = points.shape[2] - 1
    angles = np.empty((2, *points.shape[:2], m, m))  # of triangles at the lower left, and at the upper right
    for n, row in enumerate(points):  # one by one, or most of the time would go into getting memory
        right, down = np.diff(row, axis=2), np.diff(row, axis=1)
        for part, (r, d) in enumerate(((right[:, 1:], down[..., :-1, :]), (right[:, :-1], down[..., 1:, :]))):
            (rx, ry, rz), (dx, dy, dz) = np.moveaxis(r, -1, 0), np.moveaxis(d, -1, 0)
            across = np.hypot(dy * rz - dz * ry, dz * rx - dx * rz)
            angles[part, n] = np.degrees(np.arctan2(across, dx * ry - dy * rx))
    return angles.reshape(-1)


def surface_metrics(built: HeightField) -> dict[str, float]:
    """Steps, slopes and extent of a height field, mm and degrees, by their names in the manifest."""
    several = built.lens.facets > 1
    steps = np.concatenate([s.ravel() for s in wall_steps(built.heights_mm)]) if several else np.zeros(1)
    points = built.facet_points_mm()
    slopes = facet_slopes_deg(points)
    return {
        "step_mean_mm": float(steps.mean()),
        "step_max_mm": float(steps.max()),
        "slope_mean_deg": float(slopes.mean()),
        "slope_max_deg": float(slopes.max()),
        "z_min_mm": float(points[..., 2].min()),
        "z_max_mm": float(points[..., 2].max()),
    }
