"""Numbers that fabricators ask of a surface: steps, slopes, extent."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField
from magiclens.kernels.threads import side_by_side


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
        points: (..., k, k, 3) vertices of the facets, mm.

    Returns:
        (2, ..., k - 1, k - 1) angles between +z and the triangles' normals, degrees: those at the lower left, and those
        at the upper right.
    """
    x, y, z = np.moveaxis(points, -1, 0)
    right, down = (tuple(np.diff(p, axis=axis) for p in (x, y, z)) for axis in (-1, -2))
    angles = np.empty((2, *x.shape[:-2], x.shape[-2] - 1, x.shape[-1] - 1))
    sides = (np.s_[..., 1:, :], np.s_[..., :-1]), (np.s_[..., :-1, :], np.s_[..., 1:])
    for part, (row, column) in enumerate(sides):
        (rx, ry, rz), (dx, dy, dz) = (r[row] for r in right), (d[column] for d in down)
        across = np.sqrt((dy * rz - dz * ry) ** 2 + (dz * rx - dx * rz) ** 2)
        np.degrees(np.arctan2(across, dx * ry - dy * rx), out=angles[part])
    return angles


def surface_metrics(built: HeightField) -> dict[str, float]:
    """Steps, slopes and extent of a height field, mm and degrees, by their names in the manifest."""
    several = built.lens.facets > 1
    steps = np.concatenate([s.ravel() for s in wall_steps(built.heights_mm)]) if several else np.zeros(1)

    def of_row(row: int) -> tuple[float, float, float, float]:
        points = built.facet_points_mm(slice(row, row + 1))
        slopes, z = facet_slopes_deg(points), points[..., 2]
        return slopes.mean(), slopes.max(), z.min(), z.max()

    # row by row, or most of the time would go into getting memory
    slope_means, slope_maxima, lowest, highest = zip(*side_by_side(of_row, range(built.lens.facets)), strict=True)
    return {
        "step_mean_mm": float(steps.mean()),
        "step_max_mm": float(steps.max()),
        "slope_mean_deg": float(np.mean(slope_means)),
        "slope_max_deg": float(max(slope_maxima)),
        "z_min_mm": float(min(lowest)),
        "z_max_mm": float(max(highest)),
    }
