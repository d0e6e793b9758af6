"""Finishing: zig-zag over the surface, line beside line."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.milling.border import Rectangle, inner_rectangle
from magiclens.milling.operation import Operation
from magiclens.milling.toolpath import Toolpath

_BATCH = 4_000_000
"""Number of samples that are held in memory at once."""


def add_finishing(op: Operation, path: Toolpath, part: Rectangle) -> float:
    """Add the lines of a part to a toolpath, alternately to the right and to the left.

    Args:
        op: finishing, on the whole solid.
        path: the toolpath to add to.
        part: what is milled.

    Returns:
        How far the heights of neighbouring lines differ at most within the top, mm.
    """
    nodes, lines = op.nodes(part), op.lines(part)
    _, lift = op.lifts(nodes, lines)
    x0, x1, y0, y1 = inner_rectangle(op.solid)
    inside = (nodes >= x0) & (nodes <= x1)
    jump, before = 0.0, None
    for row, z in enumerate(_tips_of_lines(op, nodes, lines)):
        if before is not None and y0 <= lines[row - 1] and lines[row] <= y1:
            jump = max(jump, float(np.abs(z - before)[inside].max(initial=0.0)))
        before = z
        points = op.corners(nodes, lines[row], z, op.options.tolerance_mm)[:: -1 if row % 2 else 1]
        # to the first line over the plate, to others over the surface, high enough for the step to the side
        if row == 0:
            path.travel(*points[0, :2])
        else:
            side = 0 if row % 2 == 0 else -1
            over = op.on_grid_above(max(lift[row - 1, side], lift[row, side], path.here[2], points[0, 2]))
            path.cut([(*path.here[:2], over), (points[0, 0], points[0, 1], over)], op.options.feed)
        path.cut(points[:1], op.options.plunge)
        path.cut(points[1:], op.options.feed)
    return jump


def _tips_of_lines(op: Operation, nodes: FloatArray, lines: FloatArray) -> Iterator[FloatArray]:
    """(nodes,) tip heights of each line; a batch of lines is computed at a time."""
    batch = max(_BATCH // (len(nodes) * op.spacing[1]), 1)
    for start in range(0, len(lines), batch):
        yield from op.tips(nodes, lines[start : start + batch])
