"""Is a solid fit for fabrication? Pure checks of a triangle mesh, as a float32 file will hold it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from magiclens.contract.artifacts import IntArray, Solid
from magiclens.geometry.solid import faces_in_parts, is_built_on_grid, volume
from magiclens.meshing.intersections import cannot_cut_itself, faces_that_cut

_TOPOLOGY = ("watertight", "two_manifold", "consistently_oriented", "bodies")
"""What ``check_topology`` measures; all are 1 for a sound solid."""

Search = Literal["auto", "always", "never"]

FaceSearch = Callable[[Solid], IntArray]
"""From a closed solid to the indices (F,) of its faces that cut others."""


@dataclass(frozen=True)
class Flaw:
    """What makes a solid unfit, how often it occurs, and a vertex where it does first (None: the whole solid)."""

    what: str
    count: int
    vertex: int | None = None


@dataclass(frozen=True)
class Validation:
    """What is known of a solid, and what is wrong with it."""

    metrics: Mapping[str, float]
    flaws: tuple[Flaw, ...]

    def __add__(self, other: Validation) -> Validation:
        return Validation({**self.metrics, **other.metrics}, self.flaws + other.flaws)


def validate(solid: Solid, search: Search = "auto", find: FaceSearch = faces_that_cut) -> Validation:
    """All checks of this module; those that need a closed, oriented surface are left out when there is none.

    Args:
        solid: it is checked as a float32 file will hold it.
        search: whether faces that cut others are searched for; `auto`: where the solid's structure does not exclude
            them.
        find: how they are searched for.
    """
    exported = as_exported(solid)
    found = check_topology(exported) + check_areas(exported)
    if not found.flaws:
        found += check_volume(exported)
    if not found.flaws and search != "never":
        found += check_self_intersections(exported, search == "auto", find)
    return found


def as_exported(solid: Solid) -> Solid:
    """The solid with its vertices rounded to float32, as STL and PLY files hold them."""
    rounded = solid.vertices.astype(np.float32).astype(np.float64)
    return Solid(rounded, solid.faces, solid.grid, solid.eye_mm, dict(solid.metrics))


class MeshEdges:
    """The edges of a triangle mesh, sorted so that all uses of an edge by a face follow one another.

    A use is numbered 3 f + k: it runs from corner k of face f to the next one. ``start`` and ``end`` are the vertices
    of every use, ``order`` the sorted uses; ``open``, ``paired`` and ``crowded`` are the positions in ``order`` of the
    first use of each edge that one, two and more than two faces have.
    """

    def __init__(self, faces: IntArray, vertices: int):
        """faces: (F, 3), indices below ``vertices``."""
        self.start = faces.astype(np.int64).ravel()
        self.end = np.roll(faces, -1, axis=1).astype(np.int64).ravel()
        edge = np.minimum(self.start, self.end) * vertices + np.maximum(self.start, self.end)
        self.order = np.argsort(edge)
        edge = edge[self.order]
        first = np.flatnonzero(np.concatenate([[True], edge[1:] != edge[:-1]]))
        uses = np.diff(np.append(first, len(edge)))
        self.open, self.paired, self.crowded = first[uses == 1], first[uses == 2], first[uses > 2]

    @property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """The two uses of every edge that two faces have."""
        return self.order[self.paired], self.order[self.paired + 1]

    def vertex(self, position: int) -> int:
        """The lower vertex of the edge at a position in ``order``."""
        use = self.order[position]
        return int(min(self.start[use], self.end[use]))


def check_topology(solid: Solid) -> Validation:
    """Watertight, two-manifold, consistently oriented, one body; what is built on a grid is so by construction."""
    if is_built_on_grid(solid):
        return Validation(dict.fromkeys(_TOPOLOGY, 1.0), ())
    edges = MeshEdges(solid.faces, len(solid.vertices))
    one, other = edges.pairs
    flipped = edges.paired[edges.start[one] == edges.start[other]]
    flaws = [
        Flaw(what, len(found), edges.vertex(found[0]))
        for what, found in (
            ("edges that bound one face only", edges.open),
            ("edges that bound more than two faces", edges.crowded),
            ("edges between faces of opposite orientation", flipped),
        )
        if len(found)
    ]
    # Fans can be told apart only where it is known which faces belong together.
    clear = not len(edges.crowded) and not len(flipped)
    pinched = _pinched_vertices(edges, len(solid.vertices)) if clear else np.empty(0, np.int64)
    if len(pinched):
        flaws.append(Flaw("vertices that join surfaces which are not neighbours", len(pinched), int(pinched[0])))
    bodies = _bodies(edges, len(solid.vertices))
    if bodies > 1:
        flaws.append(Flaw("separate bodies", bodies))
    watertight = not len(edges.open) and not len(edges.crowded)
    found = watertight, watertight and not len(pinched), not len(flipped), bodies
    return Validation(dict(zip(_TOPOLOGY, map(float, found), strict=True)), tuple(flaws))


def check_areas(solid: Solid) -> Validation:
    """No face is thinner than what float32 can tell apart at the solid's size."""
    finest, thin_parts = float(np.spacing(np.float32(np.abs(solid.vertices).max()))), [np.empty(0, np.int64)]
    for part in faces_in_parts(solid.faces):
        a, b, c = (solid.vertices.take(solid.faces[part, k], axis=0) for k in range(3))
        sides = (b - a, c - b, a - c)
        longest = np.maximum.reduce([np.einsum("ij,ij->i", side, side) for side in sides])
        across = np.cross(sides[0], sides[1])
        thin = np.einsum("ij,ij->i", across, across) <= finest**2 * longest
        thin_parts.append(part.start + np.flatnonzero(thin))
    found = np.concatenate(thin_parts)
    flaws = (Flaw("faces without area", len(found), int(solid.faces[found[0]].min())),) if len(found) else ()
    return Validation({"zero_area_faces": float(len(found))}, flaws)


def check_volume(solid: Solid) -> Validation:
    """Normals point outward. The solid must be closed and consistently oriented."""
    volume_mm3 = volume(solid)
    flaws = (Flaw("faces that point inward", len(solid.faces)),) if volume_mm3 <= 0 else ()
    return Validation({"volume_mm3": volume_mm3, "outward_normals": float(volume_mm3 > 0)}, flaws)


def check_self_intersections(solid: Solid, reason: bool, find: FaceSearch = faces_that_cut) -> Validation:
    """No face cuts another one. The search takes long; ``reason`` spares it where the solid's structure allows."""
    if reason and cannot_cut_itself(solid):
        return Validation({"self_intersections": 0.0}, ())
    cut = find(solid)
    flaws = (Flaw("faces that cut through others", len(cut), int(solid.faces[cut[0]].min())),) if len(cut) else ()
    return Validation({"self_intersections": float(len(cut))}, flaws)


def _pinched_vertices(edges: MeshEdges, vertices: int) -> IntArray:
    """Vertices whose faces form more than one fan: a set of corners, linked across the edges between them."""
    one, other = edges.pairs
    # Neighbours run along their common edge in opposite directions, so one starts where the other ends.
    corners = np.concatenate([one, other]), np.concatenate([_next(other), _next(one)])
    fan = _components(*corners, len(edges.start))
    vertex_of_fan = np.empty(fan.max() + 1, np.int64)
    vertex_of_fan[fan] = edges.start
    return np.flatnonzero(np.bincount(vertex_of_fan, minlength=vertices) > 1)


def _next(use: IntArray) -> IntArray:
    """The use that follows in the same face."""
    return use + np.where(use % 3 == 2, -2, 1)


def _bodies(edges: MeshEdges, vertices: int) -> int:
    """How many parts share no vertex."""
    return len(np.unique(_components(edges.start, edges.end, vertices)[edges.start]))


def _components(start: IntArray, end: IntArray, nodes: int) -> IntArray:
    """(nodes,) label of the connected part that a node of the graph belongs to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(start), np.int8), (start, end)), shape=(nodes, nodes))
    labels: IntArray = connected_components(graph, directed=False)[1]
    return labels
