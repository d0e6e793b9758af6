"""Roughing: level by level, until only the allowance for finishing is left on the surface."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.milling.border import Rectangle
from magiclens.milling.operation import Operation
from magiclens.milling.toolpath import Toolpath

_BRIDGE_MM = 15.0
"""Gaps in a line up to this length are crossed over the surface rather than at the safe height, which is faster."""


def add_roughing(op: Operation, path: Toolpath, part: Rectangle) -> None:
    """Add to a toolpath what removes all that is above the surface with its allowance, in a part."""
    nodes, lines, down = op.nodes(part), op.lines(part), op.options.rough_stepdown_mm
    low = op.tips(nodes, lines) + op.options.allowance
    # -low: z = 0 is the plate's top. 1e-9: a depth of a whole number of levels must not get one more by rounding
    for level in range(math.ceil(-float(low.min()) / down - 1e-9)):
        before, after = np.maximum(low, -level * down), np.maximum(low, -(level + 1) * down)
        # less than half a machine's step is rounding, not material
        _level(op, path, nodes, lines, after, before - after > op.options.step_mm / 2)
        path.lift()


def _level(
    op: Operation, path: Toolpath, nodes: FloatArray, lines: FloatArray, z: FloatArray, waiting: BoolArray
) -> None:
    """Follow heights wherever there is material waiting.

    Args:
        op, path: the operation, and the toolpath to add to.
        nodes, lines: (columns,) x and (rows,) y, mm.
        z: (rows, columns) heights to follow, mm.
        waiting: (rows, columns) whether there is material above.
    """
    spacing = float(nodes[1] - nodes[0])
    columns, lift = op.lifts(nodes, lines)
    last_row = -2
    for row in np.flatnonzero(waiting.any(axis=1)).tolist():
        for first, last in _stretches(waiting[row], _BRIDGE_MM / spacing):
            at = int(np.abs(nodes - path.here[0]).argmin())
            # from the end that is nearer to the cutter
            start, end = (first, last) if abs(at - first) <= abs(at - last) else (last, first)
            way = [start, end]
            if row - last_row <= 1 and abs(at - start) * spacing <= _BRIDGE_MM and not path.up:
                near = int(np.abs(columns - path.here[0]).argmin())
                over = max(lift[max(row - 1, 0) : row + 1, near].max() + op.options.allowance, path.here[2], z[row, at])
                height = op.on_grid_above(over)
                path.cut([(*path.here[:2], height), (nodes[at], lines[row], height)], op.options.feed)
                way = [at, start, end]
            else:
                path.travel(nodes[start], lines[row])
            for a, b in pairwise(way):
                _follow(op, path, nodes, lines[row], z[row], (a, b))
            last_row = row


def _follow(
    op: Operation, path: Toolpath, nodes: FloatArray, y: float, z: FloatArray, between: tuple[int, int]
) -> None:
    """Down to heights z (nodes,) and along them from one node to another, forward or backward."""
    start, end = between
    part = slice(min(start, end), max(start, end) + 1)
    # a fifth of the allowance is exact enough for a surface that finishing cuts once more
    points = op.corners(nodes[part], y, z[part], max(op.options.tolerance_mm, op.options.allowance / 5))
    points = points if start <= end else points[::-1]
    path.cut(points[:1], op.options.plunge)
    path.cut(points[1:], op.options.feed)


def _stretches(waiting: BoolArray, gap: float) -> list[tuple[int, int]]:
    """First and last node of each stretch with material, a node wider at both ends; gaps of few nodes are closed."""
    at = np.flatnonzero(waiting)
    breaks = np.flatnonzero(np.diff(at) > max(gap, 2))
    first, last = at[np.r_[0, breaks + 1]] - 1, at[np.r_[breaks, len(at) - 1]] + 1
    return [(max(int(a), 0), min(int(b), len(waiting) - 1)) for a, b in zip(first, last, strict=True)]
