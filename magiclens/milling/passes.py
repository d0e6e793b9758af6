"""Roughing in levels and finishing, both along lines of constant y, over a rectangle of a solid.

All coordinates are multiples of the machine's step. x and y are in the lens frame, z = 0 at the plate's top.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, Solid
from magiclens.milling.border import Rectangle, inner, outer, top_of
from magiclens.milling.cutter import Cutter
from magiclens.milling.exporter import Milling
from magiclens.milling.lines import covering, segments, thinned
from magiclens.milling.moves import Path
from magiclens.milling.offset import Contacts
from magiclens.milling.outline import touch

SAG_MM = 5e-5
"""How far a cutter's true path may bulge above the straight line between two samples."""
COARSEST_MM, FINEST_MM = 0.02, 0.002
BATCH = 4_000_000
"""Samples that are held at once."""
BRIDGE_MM = 15.0
"""Gaps in a line of roughing that are crossed over the surface rather than at the safe height."""
LIFT_MM = 0.5
"""Raster on which it is known how high a cutter must be to step to the next line."""


@dataclass(frozen=True)
class Pass:
    """One operation with its cutter, on the whole of a solid with a grid.

    thickness_mm: z of the plate's top. slope: the tangent that lines go on for beyond the solid's border.
    """

    options: Milling
    name: str
    solid: Solid
    thickness_mm: float
    slope: float

    @property
    def number(self) -> int:
        """The cutter's place in the tool table."""
        return self.options.cutters[self.name][0]

    @property
    def cutter(self) -> Cutter:
        """What cuts."""
        return self.options.cutters[self.name][1]

    def cut(self, path: Path, part: Rectangle) -> float:
        """Mill a part of the whole; returns how far the heights of neighbouring lines of finishing differ, at most."""
        path.take(self.number)
        jump = _rough(self, path, part) if self.name == "roughing" else _finish(self, path, part)
        path.away()
        return jump

    @cached_property
    def floor_mm(self) -> float:
        """The lowest z of the top."""
        return float(top_of(self.solid)[..., 2].min())

    @cached_property
    def whole(self) -> Rectangle:
        """What the tip must go over: beyond the border wherever the cutter touches a slope beside its axis."""
        beyond = float(touch(self.cutter.outline(), self.slope, 0.0)) if self.slope else 0.0
        x0, x1, y0, y1 = outer(self.solid)
        return x0 - beyond, x1 + beyond, y0 - beyond, y1 + beyond

    @cached_property
    def contacts(self) -> Contacts:
        """Where the cutter's tip may go.

        What is sharp in a cutter makes paths that jump: it is taken to be wider by the distance of two samples, so that
        whatever lies between them is known to both.
        """
        flat, arc, slope, knee, rise, radius = self.cutter.outline().tolist()
        wider = 0.0 if arc else self.spacing[0]
        outline = np.array([flat + wider, arc, slope, knee + wider, rise, radius + wider])
        return Contacts(self.solid, outline, inner(self.solid))

    @cached_property
    def stepping(self) -> Contacts:
        """Where the cutter may go however it steps to a neighbouring line: that of a flat cutter wider by the way."""
        radius = self.cutter.diameter / 2 + self.stepover_mm + LIFT_MM
        return Contacts(self.solid, np.array([radius, 0.0, 0.0, radius, 0.0, radius]), inner(self.solid))

    @property
    def stepover_mm(self) -> float:
        """Most between two lines."""
        return self.options.rough_stepover_mm if self.name == "roughing" else self.options.stepover

    @cached_property
    def spacing(self) -> tuple[float, int]:
        """Distance of samples along a line, mm, and every so many of them is a node, where a path may turn."""
        arc, step = float(self.cutter.outline()[1]), self.options.step_mm
        wish = min(max(math.sqrt(8 * SAG_MM * arc), FINEST_MM), COARSEST_MM)
        every = max(math.ceil(step / wish), 1)
        return (step / every, every) if every > 1 else (math.floor(wish / step) * step, 1)

    def lines(self, part: Rectangle) -> FloatArray:
        """(rows,) ascending y of the lines of the whole that are in a part."""
        low, high = self.whole[2:]
        count = math.ceil((high - low) / self.stepover_mm) + 1
        step = self.options.step_mm
        y = np.unique(np.round(np.linspace(low, high, count) / step)) * step
        return y[(y >= part[2] - step) & (y <= part[3] + step)]

    def nodes(self, part: Rectangle) -> FloatArray:
        """(columns,) ascending x of the nodes that span a part."""
        spacing, every = self.spacing
        first, last = math.floor(part[0] / (spacing * every)), math.ceil(part[1] / (spacing * every))
        return np.arange(first, last + 1) * (spacing * every)

    def tips(self, nodes: FloatArray, y_mm: FloatArray) -> FloatArray:
        """(rows, nodes): lowest z of the tip at the nodes such that straight lines between them cut nothing away."""
        spacing, every = self.spacing
        samples = np.linspace(nodes[0], nodes[-1], (len(nodes) - 1) * every + 1)
        arc = float(self.cutter.outline()[1])
        z = self.contacts.tips(samples, y_mm, self.floor_mm)
        tips: FloatArray = thinned(covering(z, spacing**2 / arc) if arc else z, every) - self.thickness_mm
        return tips

    def lifts(self, nodes: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x (columns,) and z (rows, columns) from which the tip may step to a neighbouring line anywhere near x."""
        x = np.linspace(nodes[0], nodes[-1], max(math.ceil((nodes[-1] - nodes[0]) / LIFT_MM), 1) + 1)
        return x, self.stepping.tips(x, y_mm, self.floor_mm) - self.thickness_mm

    def corners(self, nodes: FloatArray, y: float, z: FloatArray, tolerance: float) -> FloatArray:
        """(K, 3): where a path turns that follows heights z at the nodes from above."""
        (spacing, every), step = self.spacing, self.options.step_mm
        at, count = segments(np.ascontiguousarray(z), spacing * every, tolerance, step)
        return np.column_stack([nodes[at], np.full(len(at), y), count * step])

    def up(self, z: float) -> float:
        """The least height on the machine's grid that is not below z, with a hair's breadth to spare."""
        step = self.options.step_mm
        return math.ceil((z + SAG_MM) / step) * step


def _finish(op: Pass, path: Path, part: Rectangle) -> float:
    """Zig-zag over the surface; returns the largest difference of heights side by side."""
    nodes, lines = op.nodes(part), op.lines(part)
    _, lift = op.lifts(nodes, lines)
    x0, x1, y0, y1 = inner(op.solid)
    inside = (nodes >= x0) & (nodes <= x1)
    jump, before = 0.0, None
    for row, z in enumerate(_batches(op, nodes, lines)):
        if before is not None and y0 <= lines[row - 1] and lines[row] <= y1:
            jump = max(jump, float(np.abs(z - before)[inside].max(initial=0.0)))
        before = z
        points = op.corners(nodes, lines[row], z, op.options.tolerance_mm)[:: -1 if row % 2 else 1]
        if row == 0:
            path.over(*points[0, :2])
        else:
            side = 0 if row % 2 == 0 else -1
            over = op.up(max(lift[row - 1, side], lift[row, side], path.here[2], points[0, 2]))
            _across(path, (points[0, 0], points[0, 1]), over, op.options.feed)
        path.to(points[:1], op.options.plunge)
        path.to(points[1:], op.options.feed)
    return jump


def _batches(op: Pass, nodes: FloatArray, lines: FloatArray) -> Iterator[FloatArray]:
    """The tips of each line, some lines at a time."""
    batch = max(BATCH // (len(nodes) * op.spacing[1]), 1)
    for start in range(0, len(lines), batch):
        yield from op.tips(nodes, lines[start : start + batch])


def _rough(op: Pass, path: Path, part: Rectangle) -> float:
    """Level by level, what stands above the next level and above the surface with its allowance."""
    nodes, lines, down = op.nodes(part), op.lines(part), op.options.rough_stepdown_mm
    low = op.tips(nodes, lines) + op.options.allowance
    for level in range(math.ceil(-float(low.min()) / down - 1e-9)):
        before, after = np.maximum(low, -level * down), np.maximum(low, -(level + 1) * down)
        _level(op, path, nodes, lines, after, before - after > op.options.step_mm / 2)
        path.away()
    return math.inf


def _level(op: Pass, path: Path, nodes: FloatArray, lines: FloatArray, z: FloatArray, waiting: BoolArray) -> None:
    """Follow heights z (rows, nodes) wherever there is material waiting."""
    spacing = float(nodes[1] - nodes[0])
    columns, lift = op.lifts(nodes, lines)
    last_row = -2
    for row in np.flatnonzero(waiting.any(axis=1)).tolist():
        for first, last in _stretches(waiting[row], BRIDGE_MM / spacing):
            at = int(np.abs(nodes - path.here[0]).argmin())
            start, end = (first, last) if abs(at - first) <= abs(at - last) else (last, first)
            way = [start, end]
            if row - last_row <= 1 and abs(at - start) * spacing <= BRIDGE_MM and not path.up:
                near = int(np.abs(columns - path.here[0]).argmin())
                over = max(lift[max(row - 1, 0) : row + 1, near].max() + op.options.allowance, path.here[2], z[row, at])
                _across(path, (nodes[at], lines[row]), op.up(over), op.options.feed)
                way = [at, start, end]
            else:
                path.over(nodes[start], lines[row])
            for a, b in pairwise(way):
                _follow(op, path, nodes, lines[row], z[row], a, b)
            last_row = row


def _across(path: Path, to: tuple[float, float], over: float, feed: float) -> None:
    """Up to a height and across to (x, y)."""
    path.to([(*path.here[:2], over), (*to, over)], feed)


def _follow(op: Pass, path: Path, nodes: FloatArray, y: float, z: FloatArray, start: int, end: int) -> None:
    """Down to heights z (nodes,) and along them from one node to another."""
    part = slice(min(start, end), max(start, end) + 1)
    points = op.corners(nodes[part], y, z[part], max(op.options.tolerance_mm, op.options.allowance / 5))
    points = points if start <= end else points[::-1]
    path.to(points[:1], op.options.plunge)
    path.to(points[1:], op.options.feed)


def _stretches(waiting: BoolArray, gap: float) -> list[tuple[int, int]]:
    """First and last node of each stretch with material, a node wider at both ends; short gaps are closed."""
    at = np.flatnonzero(waiting)
    breaks = np.flatnonzero(np.diff(at) > max(gap, 2))
    first, last = at[np.r_[0, breaks + 1]] - 1, at[np.r_[breaks, len(at) - 1]] + 1
    return [(max(int(a), 0), min(int(b), len(waiting) - 1)) for a, b in zip(first, last, strict=True)]
