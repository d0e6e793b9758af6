"""A solid as layers of voxels. A voxel is filled if its centre lies in the solid: no surface is moved on average.

Along the vertical line through the centres of a column of voxels the solid begins and ends where the line crosses its
surface, however often that is, so undercuts and leaning sides need no special care. Crossings are sorted by layer; from
one layer to the next only the columns that cross in between change.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, IntArray, Solid
from magiclens.exporting.voxels_kernels import RowedMesh, VoxelCentres, flip, sort_crossings
from magiclens.geometry.columns import rows_at
from magiclens.processes.diffusion import FLOYD_STEINBERG
from magiclens.processes.layers import WHOLE_LAYERS, Grey, Slicing, tops_of

Bitmap = NDArray[np.uint8]
"""(rows, ceil(columns / 8)) uint8: eight voxels to a byte, the left one in the highest bit."""


@dataclass(frozen=True)
class VoxelGrid:
    """Where the voxels are: the box of a solid to the nearest voxel, centred on it, from its lowest point up.

    No voxel outside has its centre in the solid.

    Attributes:
        pixel_mm: Width (x) and depth (y) of a voxel.
        layer_mm: Height (z) of a voxel.
        shape: Number of layers, rows and columns.
        first_mm: (x, y, z) of the centre of the first voxel: lowest layer, row at +y, column at -x; lens frame.
    """

    pixel_mm: tuple[float, float]
    layer_mm: float
    shape: tuple[int, int, int]
    first_mm: tuple[float, float, float]

    @classmethod
    def around(cls, solid: Solid, pixel_mm: tuple[float, float], layer_mm: float) -> VoxelGrid:
        """The voxels of a solid's bounding box; ``pixel_mm`` and ``layer_mm`` are those of the class."""
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


@dataclass(frozen=True)
class BitLayers:
    """Layers whose voxels are filled or empty, as what changes from one to the next.

    Attributes:
        shape: Rows and columns.
        starts: (layers + 1,) where each layer begins among the places.
        places: Voxels that change, row * columns + column.
    """

    shape: tuple[int, int]
    starts: IntArray
    places: IntArray

    @classmethod
    def of(
        cls,
        solid: Solid,
        grid: VoxelGrid,
        slicing: Slicing = "plain",
        weights: FloatArray = FLOYD_STEINBERG,
        on_plate: bool = True,
    ) -> BitLayers:
        """The layers of a solid.

        Args:
            solid: The solid.
            grid: Where its voxels are.
            slicing: Whether voxels are filled if their centres lie in the solid, or the heights of columns are rounded
                by error diffusion; then what overhangs is filled down to the bottom.
            weights: Of error diffusion, see ``diffusion_weights``.
            on_plate: Whether the solid lies flat; columns of one that stands tilted begin at its lower side.
        """
        changes = _crossings(solid, grid) if slicing == "plain" else _diffused(solid, grid, weights, on_plate)
        return cls(grid.shape[1:], *changes)

    def pixels(self, wanted: range) -> Iterator[tuple[Bitmap, bool]]:
        """Some layers from the lowest of them up, and whether each differs from the one below; the first of all does.

        All layers share their memory: use one before asking for the next.
        """
        rows, columns = self.shape
        bitmap = np.zeros((rows, -(-columns // 8)), np.uint8)
        flip(bitmap, self.places[: self.starts[wanted.start]], columns)
        for k in wanted:
            start, end = self.starts[k], self.starts[k + 1]
            flip(bitmap, self.places[start:end], columns)
            yield bitmap, k == 0 or bool(end > start)


@dataclass(frozen=True)
class GreyLayers:
    """Layers in 8-bit pixels, 255 where a layer is whole and less on top of columns, as where columns begin and end.

    Attributes:
        shape: Rows and columns.
        values: Of pixels above the last whole layer of a column, see ``Grey.steps``.
        ends: Columns in the order of their tops, row * columns + column.
        end_starts: (layers * values + 1,) where each top begins among them.
        begins: Columns in the order of the layers in which they begin.
        begin_starts: (layers + 1,) where each layer begins among them.
    """

    shape: tuple[int, int]
    values: IntArray
    ends: IntArray
    end_starts: IntArray
    begins: IntArray
    begin_starts: IntArray

    @classmethod
    def of(
        cls,
        solid: Solid,
        grid: VoxelGrid,
        slicing: Slicing,
        grey: Grey,
        weights: FloatArray = FLOYD_STEINBERG,
        on_plate: bool = True,
    ) -> GreyLayers:
        """The layers of a solid, see ``BitLayers.of``; what overhangs is filled down to the bottom.

        ``grey`` says how exposure and height go together.
        """
        values, shares = grey.steps()
        tops = _tops(solid, grid, slicing, weights, shares)
        ends = _by_top(tops, grid.shape[0] * len(shares))
        begins = _by_top(_feet(solid, grid, tops, len(shares), on_plate), grid.shape[0])
        return cls(grid.shape[1:], values, *ends, *begins)

    def pixels(self, wanted: range) -> Iterator[tuple[NDArray[np.uint8], bool]]:
        """See ``BitLayers.pixels``."""
        layer, steps = np.zeros(self.shape, np.uint8), len(self.values)
        for k in range(wanted.stop):
            first = k * steps
            begins = self.begins[self.begin_starts[k] : self.begin_starts[k + 1]]
            layer.ravel()[begins] = 255
            changed = k == 0 or len(begins) > 0
            for step, value in enumerate(self.values):  # columns that end in this layer
                ends = self.ends[self.end_starts[first + step] : self.end_starts[first + step + 1]]
                layer.ravel()[ends] = value
                changed |= len(ends) > 0
            if k > 0:  # what had ended in the layer below
                over = self.ends[self.end_starts[first - steps] : self.end_starts[first]]
                layer.ravel()[over] = 0
                changed |= len(over) > 0
            if k >= wanted.start:
                yield layer, changed


def _diffused(solid: Solid, grid: VoxelGrid, weights: FloatArray, on_plate: bool) -> tuple[IntArray, IntArray]:
    """The same as ``_crossings`` for columns whose heights are rounded by error diffusion."""
    tops = _tops(solid, grid, "diffused", weights)
    if not on_plate:
        feet = _feet(solid, grid, tops, 1, on_plate)
        filled = np.flatnonzero(feet < tops)
        events, starts = _by_top(np.concatenate([feet[filled], tops[filled]]), grid.shape[0])
        return starts[:-1], filled[events % max(len(filled), 1)].astype(np.int32)
    order, starts = _by_top(tops, grid.shape[0])
    # columns that are not empty begin in the lowest layer; each then ends in the layer above its last
    below = starts[1:-1]
    places = np.concatenate([order[below[0] :], order[below[0] : below[-1]]])
    return np.concatenate([[0], len(order) - below[0] + below - below[0]]), places


def _tops(
    solid: Solid, grid: VoxelGrid, slicing: Slicing, weights: FloatArray, shares: FloatArray = WHOLE_LAYERS
) -> IntArray:
    """(rows * columns,) tops of the columns, see ``tops_of``."""
    from magiclens.geometry.columns import top_heights

    floor = grid.first_mm[2] - grid.layer_mm / 2
    heights = np.nan_to_num(top_heights(solid, grid.columns_mm(), grid.rows_mm()) - floor, nan=0.0)
    tops = tops_of(heights, grid.layer_mm, slicing, shares, weights)
    # diffusion may put a column above the highest layer
    return np.minimum(tops, grid.shape[0] * len(shares)).ravel()


def _feet(solid: Solid, grid: VoxelGrid, tops: IntArray, steps: int, on_plate: bool) -> IntArray:
    """(rows * columns,) the layer in which each column begins; the number of layers for columns that are empty.

    Args:
        solid: The solid.
        grid: Where its voxels are.
        tops: (rows * columns,), see ``_tops``.
        steps: Number of tops that a layer has.
        on_plate: See ``BitLayers.of``.
    """
    from magiclens.geometry.columns import top_heights

    feet = np.zeros(len(tops), np.int32)
    if not on_plate:
        upside_down = Solid(solid.vertices * (1, 1, -1), solid.faces)
        lower = -top_heights(upside_down, grid.columns_mm(), grid.rows_mm()).ravel()
        feet = np.ceil((np.nan_to_num(lower, nan=np.inf) - grid.first_mm[2]) / grid.layer_mm).clip(0, grid.shape[0])
    return np.where((tops > 0) & (feet * steps < tops), feet, grid.shape[0]).astype(np.int32)


def _by_top(tops: IntArray, highest: int) -> tuple[IntArray, IntArray]:
    """Columns in the order of their tops, and where each top from 0 to the highest starts; at last their number."""
    # integers of 16 bits are sorted several times as fast
    order = np.argsort(tops.astype(np.min_scalar_type(highest)), kind="stable").astype(np.int32)
    return order, np.searchsorted(tops[order], np.arange(highest + 2), "left")


def _crossings(solid: Solid, grid: VoxelGrid) -> tuple[IntArray, IntArray]:
    """Which columns of voxels change from layer to layer.

    Returns:
        (layers + 1,) where each layer starts among the places; (crossings,) int32, the places: row * columns + column.
    """
    vertices = np.ascontiguousarray(solid.vertices, np.float64)
    x, y = grid.columns_mm(), grid.rows_mm()
    mesh = RowedMesh(vertices, solid.faces, *rows_at(vertices, y))
    centres = VoxelCentres(x, y, float(grid.first_mm[2]), float(grid.layer_mm))
    # twice over all faces: the first time only counts, since the places must be one array of the right length
    counts = np.zeros(grid.shape[0] + 1, np.int64)
    sort_crossings(mesh, centres, counts, np.empty(0, np.int32))
    starts = np.concatenate([[0], np.cumsum(counts[:-1])])
    places = np.empty(starts[-1], np.int32)
    sort_crossings(mesh, centres, np.append(starts[:-1], 0), places)
    return starts, places
