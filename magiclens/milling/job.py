"""From a solid and the options of milling to programs, one for each tile and, if it must be, for each cutter.

Frames: a program's origin is the middle of what it mills, z = 0 at the plate's top; with one tile that is the lens's
centre. Lines run along x; for lines along y the solid is mirrored before, and the moves after.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from magiclens.contract.artifacts import Solid
from magiclens.contract.errors import InputError
from magiclens.milling.border import Rectangle, top_vertices
from magiclens.milling.finishing import add_finishing
from magiclens.milling.operation import SAG_MM, Operation
from magiclens.milling.options import MillingOptions
from magiclens.milling.program import MillingProgram, MillingSetup
from magiclens.milling.roughing import add_roughing
from magiclens.milling.scallop import scallop_mm
from magiclens.milling.toolpath import Toolpath

_PLATE_MM = 0.01
"""The plate's thickness is a multiple of this length."""


@dataclass(frozen=True)
class Job:
    """The programs that mill a lens, and the plate that they begin with.

    Attributes:
        programs: The programs, in the order in which they run.
        plate_mm: Width, depth and thickness of the plate to begin with.
        depth_mm: How far below the plate's top the lens reaches.
        slope: The tangent that 99 % of the lens's top, seen from above, do not exceed.
    """

    programs: tuple[MillingProgram, ...]
    plate_mm: tuple[float, float, float]
    depth_mm: float
    slope: float


def milling_job(options: MillingOptions, solid: Solid) -> Job:
    """All programs for a solid. Raises InputError if a cutter is too short, the plate too thin or the bed too small."""
    if options.axis == "x":
        return _along_x(options, solid, options.bed)
    # exchanging x and y mirrors the solid, so the corners of its faces are reversed to keep normals pointing outward
    mirrored = replace(solid, vertices=solid.vertices[:, [1, 0, 2]], faces=solid.faces[:, ::-1])
    job = _along_x(options, mirrored, options.bed[::-1] if options.bed else None)
    width, depth, thickness = job.plate_mm
    return replace(job, programs=tuple(map(_mirrored, job.programs)), plate_mm=(depth, width, thickness))


def _mirrored(program: MillingProgram) -> MillingProgram:
    """The program with x and y exchanged."""
    x, y, z = program.setup.zero_mm
    moves = replace(program.moves, points=program.moves.points[:, [1, 0, 2]])
    return MillingProgram(moves, replace(program.setup, zero_mm=(y, x, z)))


def _along_x(options: MillingOptions, solid: Solid, bed: tuple[float, float] | None) -> Job:
    if solid.grid is None:
        wish = "milling needs the top's regular grid, which a finisher has removed; use the mesh files"
        raise InputError(wish, keys=("pipeline.finisher",))
    z = top_vertices(solid)[..., 2]
    lowest, highest = float(z.min()), float(z.max())
    # rounding must not make a plate of exactly the lens's height one step thicker
    thickness = options.stock or math.ceil(highest / _PLATE_MM - 1e-9) * _PLATE_MM
    options.require_depth(lowest, highest, thickness)
    slope = _slope(solid)
    size = np.ptp(solid.vertices[:, :2], axis=0)
    operations = [Operation(options, name, solid, thickness, slope) for name in options.cutters]
    low_x, high_x, low_y, high_y = zip(*(op.whole for op in operations), strict=True)
    tiles = _tiles(options, Rectangle(min(low_x), max(high_x), min(low_y), max(high_y)), bed)
    groups = _groups(options, operations)
    programs = tuple(_program(options, group, tile, len(tiles) > 1) for tile in tiles for group in groups)
    return Job(programs, (float(size[0]), float(size[1]), thickness), thickness - lowest, slope)


def _tiles(options: MillingOptions, whole: Rectangle, bed: tuple[float, float] | None) -> list[Rectangle]:
    """Parts of the whole that fit the bed, row by row from the lowest x and y."""
    columns, rows = options.tiles_of((whole.x1 - whole.x0, whole.y1 - whole.y0), bed)
    x = np.linspace(whole.x0, whole.x1, columns + 1).tolist()
    y = np.linspace(whole.y0, whole.y1, rows + 1).tolist()
    return [Rectangle(*across, *up) for up in pairwise(y) for across in pairwise(x)]


def _groups(options: MillingOptions, operations: list[Operation]) -> list[list[Operation]]:
    """The operations of each program: all of them, or those of one cutter if the machine cannot ask for another."""
    one = options.changes_cutters or len({op.number for op in operations}) == 1
    return [operations] if one else [[op] for op in operations]


def _program(options: MillingOptions, operations: list[Operation], tile: Rectangle, own_zero: bool) -> MillingProgram:
    """The program that mills a tile; ``own_zero``: its origin is the tile's middle, not the lens's."""
    step = options.step_mm
    middle = ((tile.x0 + tile.x1) / 2, (tile.y0 + tile.y1) / 2) if own_zero else (0.0, 0.0)
    # on the machine's grid: all coordinates in the program are then multiples of its step
    x, y = (round(at / step) * step for at in middle)
    path = Toolpath((x, y), math.ceil(options.safe_height / step - 1e-9) * step, options.feed)
    left = math.inf
    for op in operations:
        path.take(op.number)
        if op.name == "finishing":
            left = _left_mm(options, op, add_finishing(op, path, tile))
        else:
            add_roughing(op, path, tile)
        path.lift()
    cutters = {op.name: (op.number, op.cutter) for op in operations}
    setup = MillingSetup(cutters, (x, y, operations[0].thickness_mm), left)
    return MillingProgram(path.moves().shifted((-x, -y, 0.0)), setup)


def _left_mm(options: MillingOptions, op: Operation, jump: float) -> float:
    """What finishing leaves where its cutter reaches, at most, mm.

    jump: how far neighbouring lines' heights differ. Half a stepover beside the best line for a point, the tip is
    higher by half a jump at most, and so is what it leaves there; to that come the ridge as on a slope so steep, and
    what the lines themselves are too high.
    """
    ridge = scallop_mm(op.cutter.outline(), op.stepover_mm, jump / op.stepover_mm)
    return ridge + jump + options.tolerance_mm + options.step_mm + SAG_MM


def _slope(solid: Solid) -> float:
    """The slope that 99 % of the top, seen from above, do not exceed; walls are steeper."""
    rows, columns = solid.grid or (0, 0)
    corners = solid.vertices[solid.faces[(solid.faces < rows * columns).all(axis=1)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = normal[normal[:, 2] > 0]
    slope = np.linalg.norm(normal[:, :2], axis=1) / normal[:, 2]
    order = np.argsort(slope)
    # a normal's z is twice the triangle's area seen from above
    share = np.cumsum(normal[order, 2]) / normal[:, 2].sum()
    return float(slope[order][np.searchsorted(share, 0.99)])
