"""The slopes that facets need, given where the surface is now (4.3).

A vertex at (u, v) with height h lies at ``X = eye + exp(-h / D) * d``, d = (u, v, thickness) - eye. From N . X_u = 0
follows ``dh/du = D * N_x / (N . d)``, and the same for v: exact, and linear in h. Vertical cells are the limit of an
infinitely distant eye: ``dh/du = -N_x / N_z``.
"""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import Assignment, FloatArray, IntArray, Scene
from magiclens.integration.orientation_kernels import rises_along_edges
from magiclens.optics.medium import cut_of, optics_of


def edge_rises(scene: Scene, assignment: Assignment, heights: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """The rise of the height h along every mesh edge with which each point of a tile shows its point of the source.

    Each of a cell's two triangles contains one edge of either kind, so these are its exact slopes.

    Args:
        scene: the lens and its views, of which the reference eye counts.
        assignment: what the facets shall show.
        heights: (N, N, k, k) where the surface is now, mm, k = m + 1.

    Returns:
        The rises along rows (F, k, k - 1), from column b to b + 1, mm, F = N * N; the rises along columns
        (F, k - 1, k), from row a to a + 1, mm; and how many edges of each facet (F,) were held at the slope limit.
    """
    lens, n = scene.lens, scene.lens.facets
    rows, columns, clamped = rises_along_edges(
        heights.reshape(n * n, *heights.shape[2:]), lens.facet_centres_mm().reshape(-1, 2),
        assignment.offsets_mm.reshape(-1, 2).astype(np.float64), assignment.maps.reshape(-1, 3).astype(np.float64),
        lens.pitch_mm - lens.wall_mm, optics_of(lens, cut_of(scene)),
    )  # fmt: skip
    return rows, columns, clamped
