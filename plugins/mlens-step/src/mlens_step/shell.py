"""The closed shell of a lens: B-spline patches on top, sides that share their edges, a flat floor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from magiclens import FloatArray
from mlens_step import brep
from mlens_step.body import FLAT_MM, LensBody
from mlens_step.brep import Corner
from mlens_step.part21 import Part21, Ref
from mlens_step.splines import Net, averages, breaks

PatchCorner = tuple[int, int]
"""Row and column of a patch's corner, among the lines of control points at which patches end."""
_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class BorderEdge:
    """An edge of the top's border, from corner to corner counter-clockwise as the viewer sees it.

    first: its first corner. edge: the edge itself. along: whether the edge runs that way. controls, at: its control
    points and where they are, (W + 1, 3) mm. below: (3,) the floor's border below its first corner, mm.
    """

    first: Corner
    edge: Ref
    along: bool
    controls: list[Ref]
    at: FloatArray
    below: FloatArray


@dataclass(frozen=True)
class SideFace:
    """A face between the top's border and the floor's: a plane with this normal, or ruled below a single edge.

    edges: of the top, counter-clockwise as the viewer sees them. normal: (3,) outward, None if the face is ruled.
    """

    edges: list[BorderEdge]
    normal: FloatArray | None


def add_lens(file: Part21, body: LensBody, net: Net) -> Ref:
    """Write the solid between a smooth top and the floor of the body."""
    top = _Top(file, net)
    below = _floor_below(body, net)
    borders = [list(top.border(below, side)) for side in range(4)]
    ends = [border[0].below for border in (*borders[1:], borders[0])]
    sides = [side for border, end in zip(borders, ends, strict=True) for side in _side_faces(border, end)]
    return brep.solid(file, [*top.faces(), *_sides_and_floor(file, sides)])


def _floor_below(body: LensBody, net: Net) -> FloatArray:
    """(B, B, 3) whose border is where the floor is below the corners of the top's border."""
    facets = (len(net.breaks) - 2 * body.rim) // 2
    lines = breaks(facets, (len(body.top) - 2 * body.rim) // facets, body.rim)
    return np.stack(np.broadcast_arrays(body.floor_x[lines], body.floor_y[lines, None], body.floor_z), axis=-1)


class _Top:
    """The patches of a net, every vertex and every edge of which is written once."""

    def __init__(self, file: Part21, net: Net):
        self._file, self._net, self._last = file, net, len(net.breaks) - 1
        self._points = brep.points(file, net.points)
        corners = [(i, j) for i in range(len(net.breaks)) for j in range(len(net.breaks))]
        self._corners = {corner: self._corner(corner) for corner in corners}
        below = [(a, (a[0] + 1, a[1])) for a in corners if a[0] < self._last]
        right = [(a, (a[0], a[1] + 1)) for a in corners if a[1] < self._last]
        self._edges = {(a, b): self._edge(a, b) for a, b in (*below, *right)}

    def faces(self) -> Iterator[Ref]:
        """All patches, from +y down and from -x on."""
        at, edges = self._net.breaks, self._edges
        for i in range(self._last):
            for j in range(self._last):
                a, b, c, d = (i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)
                rows = [row[at[j] : at[j + 1] + 1] for row in self._points[at[i] : at[i + 1] + 1]]
                loop = [(edges[a, b], True), (edges[b, c], True), (edges[d, c], False), (edges[a, d], False)]
                yield brep.face(self._file, brep.spline_surface(self._file, rows), loop)

    def border(self, below: FloatArray, side: int) -> Iterator[BorderEdge]:
        """The border's edges on one side: left, bottom, right, top. ``below``: (B, B, 3), the floor below corners."""
        steps, last = range(self._last + 1), self._last
        path = [(k, 0) for k in steps], [(last, k) for k in steps], [(last - k, last) for k in steps]
        for a, b in pairwise((*path, [(0, last - k) for k in steps])[side]):
            edge = self._edges[min(a, b), max(a, b)]
            rows, columns = self._line(a, b)
            yield BorderEdge(self._corners[a], edge, a < b, self._refs(a, b), self._net.points[rows, columns], below[a])

    def _corner(self, at: PatchCorner) -> Corner:
        i, j = (self._net.breaks[k] for k in at)
        return brep.corner(self._file, self._net.points[i, j], self._points[i][j])

    def _edge(self, a: PatchCorner, b: PatchCorner) -> Ref:
        return brep.spline_edge(self._file, self._corners[a], self._corners[b], self._refs(a, b))

    def _refs(self, a: PatchCorner, b: PatchCorner) -> list[Ref]:
        """The control points from one corner to another."""
        return [self._points[i][j] for i, j in zip(*self._line(a, b), strict=True)]

    def _line(self, a: PatchCorner, b: PatchCorner) -> tuple[list[int], list[int]]:
        """Rows and columns of the control points from one corner to another."""
        (i, j), (k, m) = ((self._net.breaks[row], self._net.breaks[column]) for row, column in (a, b))
        steps = range(max(abs(k - i), abs(m - j)) + 1)
        down, right = np.sign(k - i), np.sign(m - j)
        return [int(i + s * down) for s in steps], [int(j + s * right) for s in steps]


def _side_faces(border: list[BorderEdge], end: FloatArray) -> list[SideFace]:
    """One plane if a side is flat, else one ruled face for each edge. ``end``: (3,) where the floor's side ends, mm."""
    points = np.concatenate([edge.at for edge in border])
    normal = np.cross(end - border[0].below, border[0].first.at - border[0].below)
    normal /= np.linalg.norm(normal)
    if np.abs((points - border[0].below) @ normal).max() < FLAT_MM:
        return [SideFace(border, normal)]
    return [SideFace([edge], None) for edge in border]


def _sides_and_floor(file: Part21, sides: list[SideFace]) -> Iterator[Ref]:
    """The faces of the sides, and the floor's."""
    corners = [brep.corner(file, side.edges[0].below) for side in sides]
    upright = [brep.straight_edge(file, low, side.edges[0].first) for low, side in zip(corners, sides, strict=True)]
    lower = [brep.straight_edge(file, a, b) for a, b in pairwise((*corners, corners[0]))]
    for k, side in enumerate(sides):
        a, b = corners[k], corners[(k + 1) % len(corners)]
        top = [(edge.edge, not edge.along) for edge in reversed(side.edges)]
        loop = [(lower[k], True), (upright[(k + 1) % len(corners)], True), *top, (upright[k], False)]
        yield brep.face(file, _surface(file, side, a, b), loop)
    floor = brep.plane(file, corners[0].point, _DOWN, corners[1].at - corners[0].at)
    yield brep.face(file, floor, [(edge, False) for edge in reversed(lower)])


def _surface(file: Part21, side: SideFace, a: Corner, b: Corner) -> Ref:
    """The surface of a side face that meets the floor between two corners."""
    if side.normal is not None:
        return brep.plane(file, a.point, side.normal, b.at - a.at)
    above = side.edges[0].controls
    along = averages(len(above) - 1)[1:-1, None]
    between = brep.points(file, (a.at + along * (b.at - a.at))[None])[0]
    return brep.spline_surface(file, list(zip([a.point, *between, b.point], above, strict=True)))
