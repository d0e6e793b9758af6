"""From a solid and a milling exporter's options to programs, one for each tile and, if it must be, for each cutter.

Frames: a program's origin is the middle of what it mills, z = 0 at the plate's top; with one tile that is the lens's
centre. Lines run along x; for lines along y the solid is mirrored on the way in and the moves on the way out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from magiclens.contract.artifacts import Solid
from magiclens.contract.errors import InputError
from magiclens.contract.units import LENGTH
from magiclens.milling.border import Rectangle, top_of
from magiclens.milling.cutter import scallop_mm
from magiclens.milling.exporter import Milling
from magiclens.milling.moves import Path
from magiclens.milling.passes import SAG_MM, Pass
from magiclens.milling.program import Facts, Program

MOST_TILES = 64
SPARE_MM = 0.1
"""Tiles are smaller than the machine's bed by so much, since lines end a little outside."""
PLATE_MM = 0.01
"""The plate's thickness is a multiple of this."""


@dataclass(frozen=True)
class Job:
    """Programs in the order in which they run.

    plate_mm: width, depth and thickness of the plate to begin with. depth_mm: how far below its top the lens reaches.
    slope: the tangent that 99 % of the lens's top, seen from above, do not exceed.
    """

    programs: tuple[Program, ...]
    plate_mm: tuple[float, float, float]
    depth_mm: float
    slope: float


def job(options: Milling, solid: Solid) -> Job:
    """All programs. Raises InputError if a cutter is too short, the plate too thin or the bed too small."""
    if options.axis == "x":
        return _job(options, solid, options.bed)
    mirrored = replace(solid, vertices=solid.vertices[:, [1, 0, 2]], faces=solid.faces[:, ::-1])
    done = _job(options, mirrored, options.bed[::-1] if options.bed else None)
    width, depth, thickness = done.plate_mm
    return replace(done, programs=tuple(map(_mirrored, done.programs)), plate_mm=(depth, width, thickness))


def _mirrored(program: Program) -> Program:
    x, y, z = program.facts.zero_mm
    moves = replace(program.moves, points=program.moves.points[:, [1, 0, 2]])
    return Program(moves, replace(program.facts, zero_mm=(y, x, z)))


def _job(options: Milling, solid: Solid, bed: tuple[float, float] | None) -> Job:
    if solid.grid is None:
        wish = "milling needs the top's regular grid, which a finisher has removed; use the mesh files"
        raise InputError(wish, f"exporter {options.type}")
    z = top_of(solid)[..., 2]
    lowest, highest = float(z.min()), float(z.max())
    thickness = options.stock or math.ceil(highest / PLATE_MM - 1e-9) * PLATE_MM
    _check(options, lowest, highest, thickness)
    slope = _slope(solid)
    size = np.ptp(solid.vertices[:, :2], axis=0)
    passes = [Pass(options, name, solid, thickness, slope) for name in options.cutters]
    low_x, high_x, low_y, high_y = zip(*(op.whole for op in passes), strict=True)
    tiles = _tiles(options, (min(low_x), max(high_x), min(low_y), max(high_y)), bed)
    groups = _groups(options, passes)
    programs = tuple(_program(options, group, tile, len(tiles) > 1) for tile in tiles for group in groups)
    return Job(programs, (float(size[0]), float(size[1]), thickness), thickness - lowest, slope)


def _check(options: Milling, lowest: float, highest: float, thickness: float) -> None:
    where = f"exporter {options.type}"
    if thickness < highest - 1e-9:
        need, has = LENGTH.text(math.ceil(highest * 100) / 100), LENGTH.text(thickness)
        raise InputError(f"the plate of {has} is thinner than the lens; it needs {need}", f"{where}: stock")
    depth = thickness - lowest
    for name, (_, cutter) in options.cutters.items():
        if cutter.reach < depth:
            need, has = LENGTH.text(math.ceil(depth * 10) / 10), LENGTH.text(cutter.reach)
            raise InputError(f"the cutter for {name} reaches {has} deep, the lens needs {need}", f"{where}: reach")


def _tiles(options: Milling, whole: Rectangle, bed: tuple[float, float] | None) -> list[Rectangle]:
    """Parts of the whole that fit the bed, row by row from the lowest x and y."""
    sides = whole[1] - whole[0], whole[3] - whole[2]
    columns, rows = (_share(side, most) for side, most in zip(sides, bed or (math.inf, math.inf), strict=True))
    if columns * rows > MOST_TILES:
        has = " x ".join(LENGTH.text(side) for side in options.bed or ())
        message = f"a bed of {has} would take more than {MOST_TILES} tiles; use a larger one"
        raise InputError(message, f"exporter {options.type}: bed")
    x, y = np.linspace(*whole[:2], columns + 1).tolist(), np.linspace(*whole[2:], rows + 1).tolist()
    return [(*across, *up) for up in pairwise(y) for across in pairwise(x)]


def _share(side: float, most: float) -> int:
    """In how many parts to cut a side."""
    return max(math.ceil(side / (most - SPARE_MM)), 1) if most > SPARE_MM else MOST_TILES + 1


def _groups(options: Milling, passes: list[Pass]) -> list[list[Pass]]:
    """What one program does: everything, or what one cutter does if the machine cannot be asked to change it."""
    one = options.changes_cutters or len({op.number for op in passes}) == 1
    return [passes] if one else [[op] for op in passes]


def _program(options: Milling, passes: list[Pass], tile: Rectangle, own_zero: bool) -> Program:
    step = options.step_mm
    x, y = (round((tile[k] + tile[k + 1]) / 2 / step) * step if own_zero else 0.0 for k in (0, 2))
    path = Path((x, y), math.ceil(options.safe_height / step - 1e-9) * step, options.feed)
    left = math.inf
    for op in passes:
        left = _left(options, op, op.cut(path, tile))
    facts = Facts({op.name: (op.number, op.cutter) for op in passes}, (x, y, passes[0].thickness_mm), left)
    return Program(path.moves().shifted((-x, -y, 0.0)), facts)


def _left(options: Milling, op: Pass, jump: float) -> float:
    """What finishing leaves where its cutter reaches, at most, mm.

    jump: how far neighbouring lines' heights differ. Half a stepover beside the best line for a point, the tip is
    higher by half a jump at most, and so is what it leaves there; to that come the ridge as on a slope so steep, and
    what the lines themselves are too high.
    """
    if op.name != "finishing":
        return math.inf
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
    share = np.cumsum(normal[order, 2]) / normal[:, 2].sum()
    return float(slope[order][np.searchsorted(share, 0.99)])
