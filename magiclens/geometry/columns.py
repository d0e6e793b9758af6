"""Solids seen along z: how high they are above the points of a raster."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, IntArray, Lens, Solid


def top_heights(solid: Solid, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """The solid's highest point above every point of a raster.

    Triangles count with their borders and are met exactly, undercuts too: what overhangs hides what lies below it.

    Args:
        solid: closed or not.
        x_mm: (columns,) of the raster's columns, ascending, lens frame.
        y_mm: (rows,) of the raster's rows, descending, lens frame.

    Returns:
        (rows, columns) float32: z above every (x_mm[column], y_mm[row]), mm; NaN beside the solid.

    Raises:
        ValueError: the lines are out of order.
    """
    from magiclens.geometry.columns_kernels import highest

    if (np.diff(x_mm) <= 0).any() or (np.diff(y_mm) >= 0).any():
        raise ValueError("x_mm must ascend and y_mm descend")
    vertices = np.ascontiguousarray(solid.vertices, np.float64)
    first, last = rows_at(vertices, y_mm)
    z: FloatArray = highest(vertices, solid.faces, np.asarray(x_mm, float), np.asarray(y_mm, float), first, last)
    z[np.isneginf(z)] = np.nan
    return z


def sampled_top(body: Solid, lens: Lens) -> HeightField:
    """The top of any body at the vertices of a lens's grid, as a height field of vertical cells.

    Args:
        body: What stands above the lens's square, such as the lens as it was printed.
        lens: Its grid is taken.
    """
    from magiclens.geometry.solid import grid_lines

    lines = grid_lines(lens)[1:-1]  # without the rim, beyond which the body may end
    n, k = lens.facets, lens.microfacets + 1
    z = top_heights(body, lines, -lines).astype(np.float64).reshape(n, k, n, k)
    return HeightField(lens, z.transpose(0, 2, 1, 3) - lens.thickness_mm, None)


def rows_at(vertices: FloatArray, y_mm: FloatArray) -> tuple[IntArray, IntArray]:
    """The rows of a raster between which every vertex lies.

    Args:
        vertices: (V, 3) mm.
        y_mm: (rows,) descending.

    Returns:
        (V,) the first row that is not above the vertex, and (V,) the last row that is not below it.
    """
    down = -vertices[:, 1]
    return np.searchsorted(-y_mm, down, "left"), np.searchsorted(-y_mm, down, "right") - 1
