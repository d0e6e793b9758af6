"""A solid as layers of voxels. A voxel is filled if its centre lies in the solid: no surface is moved on average.

Along the vertical line through the centres of a column of voxels the solid begins and ends where the line crosses its
surface, however often that is, so undercuts and leaning sides need no special care. Crossings are sorted by layer; from
one layer to the next only the columns that cross in between change.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, IntArray, Solid
from magiclens.geometry.columns import rows_at
from magiclens.geometry.columns_kernels import first_at, span

Bitmap = NDArray[np.uint8]


@dataclass(frozen=True)
class Lattice:
    """Where the voxels are: the box of a solid to the nearest voxel, centred on it, from its lowest point up.

    No voxel outside has its centre in the solid.

    pixel_mm: width (x) and height (y) of a voxel. shape: layers, rows, columns. first_mm: (x, y, z) of the centre of
    the first voxel: lowest layer, row at +y, column at -x.
    """

    pixel_mm: tuple[float, float]
    layer_mm: float
    shape: tuple[int, int, int]
    first_mm: tuple[float, float, float]

    @classmethod
    def around(cls, solid: Solid, pixel_mm: tuple[float, float], layer_mm: float) -> Lattice:
        """The voxels of a solid's bounding box."""
        low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
        sizes = np.array([*pixel_mm, layer_mm])
        columns, rows, layers = (max(int(n), 1) for n in np.rint((high - low) / sizes))
        middle = (low + high) / 2
        left, top = middle[0] - (columns - 1) / 2 * sizes[0], middle[1] + (rows - 1) / 2 * sizes[1]
        return cls(pixel_mm, layer_mm, (layers, rows, columns), (float(left), float(top), float(low[2] + layer_mm / 2)))

    @property
    def voxel_mm3(self) -> float:
        """Volume of a voxel."""
        return self.pixel_mm[0] * self.pixel_mm[1] * self.layer_mm

    def columns_mm(self) -> FloatArray:
        """(columns,) x of the voxels' centres, ascending."""
        return self.first_mm[0] + np.arange(self.shape[2]) * self.pixel_mm[0]

    def rows_mm(self) -> FloatArray:
        """(rows,) y of the voxels' centres, descending."""
        return self.first_mm[1] - np.arange(self.shape[1]) * self.pixel_mm[1]


def layers(solid: Solid, lattice: Lattice) -> Iterator[tuple[Bitmap, bool]]:
    """Every layer from the lowest up, as (rows, ceil(columns / 8)) uint8, and whether it differs from the one before.

    Eight voxels to a byte, the left one in the highest bit. All layers share their memory: use one before the next.
    """
    starts, places = _crossings(solid, lattice)
    bitmap = np.zeros((lattice.shape[1], -(-lattice.shape[2] // 8)), np.uint8)
    for start, end in pairwise(starts):
        _turn(bitmap, places[start:end], lattice.shape[2])
        yield bitmap, bool(end > start)


def _crossings(solid: Solid, lattice: Lattice) -> tuple[IntArray, IntArray]:
    """(layers + 1,) where each layer starts among the places; (crossings,) row * columns + column of what changes."""
    vertices = np.ascontiguousarray(solid.vertices, np.float64)
    x, y = lattice.columns_mm(), lattice.rows_mm()
    surface = (vertices, solid.faces, x, y, *rows_at(vertices, y), lattice.first_mm[2], lattice.layer_mm)
    counts = np.zeros(lattice.shape[0] + 1, np.int64)
    _sort(*surface, counts, np.empty(0, np.int32))
    starts = np.concatenate([[0], np.cumsum(counts[:-1])])
    places = np.empty(starts[-1], np.int32)
    _sort(*surface, np.append(starts[:-1], 0), places)
    return starts, places


@njit(cache=True)
def _sort(vertices, faces, x_mm, y_mm, first, last, lowest, layer, ends, places):
    """Count crossings by the first layer whose centre is not below them, or put them at ``ends`` if there are places.

    Rows and columns are half-open intervals: a line through a border belongs to one of the triangles beside it.
    """
    above = len(ends) - 1
    for f in range(len(faces)):
        a, b, c = faces[f]
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
                k = min(max(int(np.ceil((z - lowest) / layer)), 0), above)
                if len(places) > 0 and k < above:
                    places[ends[k]] = row * len(x_mm) + column
                ends[k] += 1
                column += 1


@njit(cache=True)
def _turn(bitmap, places, columns):
    """What was empty becomes filled, what was filled empty."""
    for place in places:
        row, column = place // columns, place % columns
        bitmap[row, column >> 3] ^= np.uint8(0x80 >> (column & 7))
