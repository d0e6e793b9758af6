"""The closed shell of a slab: B-spline patches on top, sides that share their edges, a flat floor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from magiclens import FloatArray
from mlens_step import brep
from mlens_step.brep import Corner
from mlens_step.part21 import Part21, Ref
from mlens_step.slab import FLAT_MM, Slab
from mlens_step.splines import Net, averages, breaks

Place = tuple[int, int]
"""Row and column of a patch's corner, among the lines of control points at which patches end."""
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Hem:
    """An edge of the top's border, from corner to corner counter-clockwise as the viewer sees it.

    along: whether the edge itself runs that way. controls, at: its control points and where they are, (W + 1, 3) mm.
    below: (3,) the floor's border below its first corner.
    """

    first: Corner
    edge: Ref
    along: bool
    controls: list[Ref]
    at: FloatArray
    below: FloatArray


@dataclass(frozen=True)
class Panel:
    """A face between the top's border and the floor's: a plane with this normal, or ruled below a single edge."""

    hems: list[Hem]
    normal: FloatArray | None


def add_slab(file: Part21, slab: Slab, net: Net) -> Ref:
    """The solid between a smooth top and the slab's floor."""
    top = _Top(file, net)
    feet = _feet(slab, net)
    sides = [list(top.hems(feet, side)) for side in range(4)]
    ends = [side[0].below for side in (*sides[1:], sides[0])]
    panels = [panel for side, end in zip(sides, ends, strict=True) for panel in _panels(side, end)]
    return brep.solid(file, [*top.faces(), *_skirt(file, panels)])


def _feet(slab: Slab, net: Net) -> FloatArray:
    """(B, B, 3) whose border is where the floor is below the corners of the top's border."""
    facets = (len(net.breaks) - 2 * slab.rim) // 2
    lines = breaks(facets, (len(slab.top) - 2 * slab.rim) // facets, slab.rim)
    return np.stack(np.broadcast_arrays(slab.floor_x[lines], slab.floor_y[lines, None], slab.floor_z), axis=-1)


class _Top:
    """The patches of a net, every vertex and every edge of which is written once."""

    def __init__(self, file: Part21, net: Net):
        self._file, self._net, self._last = file, net, len(net.breaks) - 1
        self._points = brep.points(file, net.points)
        places = [(i, j) for i in range(len(net.breaks)) for j in range(len(net.breaks))]
        self._corners = {place: self._corner(place) for place in places}
        below = [(a, (a[0] + 1, a[1])) for a in places if a[0] < self._last]
        right = [(a, (a[0], a[1] + 1)) for a in places if a[1] < self._last]
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

    def hems(self, feet: FloatArray, side: int) -> Iterator[Hem]:
        """The border's edges on one side: left, bottom, right, top."""
        steps, last = range(self._last + 1), self._last
        path = [(k, 0) for k in steps], [(last, k) for k in steps], [(last - k, last) for k in steps]
        for a, b in pairwise((*path, [(0, last - k) for k in steps])[side]):
            edge = self._edges[min(a, b), max(a, b)]
            rows, columns = self._line(a, b)
            yield Hem(self._corners[a], edge, a < b, self._refs(a, b), self._net.points[rows, columns], feet[a])

    def _corner(self, place: Place) -> Corner:
        i, j = (self._net.breaks[k] for k in place)
        return brep.corner(self._file, self._net.points[i, j], self._points[i][j])

    def _edge(self, a: Place, b: Place) -> Ref:
        return brep.spline_edge(self._file, self._corners[a], self._corners[b], self._refs(a, b))

    def _refs(self, a: Place, b: Place) -> list[Ref]:
        """The control points from one corner to another."""
        return [self._points[i][j] for i, j in zip(*self._line(a, b), strict=True)]

    def _line(self, a: Place, b: Place) -> tuple[list[int], list[int]]:
        """Rows and columns of the control points from one corner to another."""
        (i, j), (k, m) = ((self._net.breaks[row], self._net.breaks[column]) for row, column in (a, b))
        steps = range(max(abs(k - i), abs(m - j)) + 1)
        down, right = np.sign(k - i), np.sign(m - j)
        return [int(i + s * down) for s in steps], [int(j + s * right) for s in steps]


def _panels(side: list[Hem], end: FloatArray) -> list[Panel]:
    """One plane if the side is flat, else one ruled panel for each edge. ``end`` is where the floor's side ends."""
    points = np.concatenate([hem.at for hem in side])
    normal = np.cross(end - side[0].below, side[0].first.at - side[0].below)
    normal /= np.linalg.norm(normal)
    if np.abs((points - side[0].below) @ normal).max() < FLAT_MM:
        return [Panel(side, normal)]
    return [Panel([hem], None) for hem in side]


def _skirt(file: Part21, panels: list[Panel]) -> Iterator[Ref]:
    """The faces of the panels, and the floor's."""
    feet = [brep.corner(file, panel.hems[0].below) for panel in panels]
    posts = [brep.straight_edge(file, foot, p.hems[0].first) for foot, p in zip(feet, panels, strict=True)]
    sills = [brep.straight_edge(file, a, b) for a, b in pairwise((*feet, feet[0]))]
    for k, panel in enumerate(panels):
        a, b = feet[k], feet[(k + 1) % len(feet)]
        top = [(hem.edge, not hem.along) for hem in reversed(panel.hems)]
        loop = [(sills[k], True), (posts[(k + 1) % len(feet)], True), *top, (posts[k], False)]
        yield brep.face(file, _surface(file, panel, a, b), loop)
    floor = brep.plane(file, feet[0].point, DOWN, feet[1].at - feet[0].at)
    yield brep.face(file, floor, [(sill, False) for sill in reversed(sills)])


def _surface(file: Part21, panel: Panel, a: Corner, b: Corner) -> Ref:
    """What a panel that stands on the floor from a to b lies on."""
    if panel.normal is not None:
        return brep.plane(file, a.point, panel.normal, b.at - a.at)
    above = panel.hems[0].controls
    along = averages(len(above) - 1)[1:-1, None]
    between = brep.points(file, (a.at + along * (b.at - a.at))[None])[0]
    return brep.spline_surface(file, list(zip([a.point, *between, b.point], above, strict=True)))
