"""Solids seen along z: how high they are above the points of a raster."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Solid


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
