"""Kernels that find where vertical lines cross a mesh, layer by layer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.geometry.columns_kernels import first_at, span
from magiclens.kernels.compiler import njit


class RowedMesh(NamedTuple):
    """A mesh, and the rows of voxels that each vertex lies between, as ``rows_at`` finds them.

    Args:
        vertices: (V, 3) float64, mm.
        faces: (F, 3) indices of vertices.
        first: (V,) the first row that is not above the vertex.
        last: (V,) the last row that is not below it.
    """

    vertices: FloatArray
    faces: IntArray
    first: IntArray
    last: IntArray


class VoxelCentres(NamedTuple):
    """Where the centres of voxels are: those of layer k at z = lowest + k layer.

    Args:
        x_mm: (columns,) ascending.
        y_mm: (rows,) descending.
        lowest: z of the lowest layer's centres, mm.
        layer: height of a layer, mm.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    lowest: float
    layer: float


@njit(cache=True)
def sort_crossings(mesh, centres, ends, places):
    """Sort the crossings of the vertical lines through voxels by layer: k = ceil((z - lowest) / layer).

    A line crosses a triangle at z = left_z + (x - left) slope, where ``span`` gives the ends of what the triangle has
    in common with the plane of a row. k is the first layer whose centre is not below the crossing. Rows and columns are
    half-open intervals: a line through a border belongs to one of the triangles beside it, so none counts twice.

    Args:
        mesh: a ``RowedMesh``.
        centres: ``VoxelCentres``.
        ends: (layers + 1,) int64, changed in place: crossings per layer are added; the last is for all that is higher.
        places: (crossings,) int32, row * columns + column of each crossing, put where ``ends`` points; empty to count.
    """
    vertices, first, last, x_mm, y_mm = mesh.vertices, mesh.first, mesh.last, centres.x_mm, centres.y_mm
    above = len(ends) - 1
    for f in range(len(mesh.faces)):
        a, b, c = mesh.faces[f]
        lower = min(vertices[a, 1], vertices[b, 1], vertices[c, 1])
        upper = max(vertices[a, 1], vertices[b, 1], vertices[c, 1])
        for row in range(min(first[a], first[b], first[c]), max(last[a], last[b], last[c]) + 1):
            if not lower <= y_mm[row] < upper:
                continue
            left, left_z, right, right_z = span(vertices, a, b, c, y_mm[row])
            column = first_at(x_mm, left)
            slope = (right_z - left_z) / (right - left) if right > left else 0.0
            while column < len(x_mm) and x_mm[column] < right:
                z = left_z + (x_mm[column] - left) * slope
                k = min(max(int(np.ceil((z - centres.lowest) / centres.layer)), 0), above)
                if len(places) > 0 and k < above:
                    places[ends[k]] = row * len(x_mm) + column
                ends[k] += 1
                column += 1


@njit(cache=True)
def flip(bitmap, places, columns):
    """Fill the voxels of some columns that were empty, and empty those that were filled.

    A place that comes twice stays as it is: between two crossings within one layer no voxel has its centre.

    Args:
        bitmap: (rows, ceil(columns / 8)) uint8, changed in place; a byte's highest bit is its leftmost voxel.
        places: row * columns + column of each.
        columns: number of columns.
    """
    for place in places:
        row, column = place // columns, place % columns
        bitmap[row, column >> 3] ^= np.uint8(0x80 >> (column & 7))
