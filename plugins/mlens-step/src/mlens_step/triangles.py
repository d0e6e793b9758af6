"""The closed shell of any mesh: one plane face for each triangle."""

from __future__ import annotations

import numpy as np

from magiclens import FloatArray, InputError, Solid, StageError
from mlens_step import brep
from mlens_step.part21 import Part21, Ref

_MOST = 50_000
"""Most triangles; as faces, more are beyond what CAD programs handle."""


def check_triangles(solid: Solid) -> None:
    """Raises InputError if there are too many, StageError if they do not enclose a solid."""
    if len(solid.faces) > _MOST:
        raise InputError(
            f"{len(solid.faces)} triangles, at most {_MOST} are possible as faces; use 'surface: splines', "
            "or fewer lens.facets or lens.microfacets",
            "exporter step: surface",
        )
    ends = np.concatenate([solid.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    _, uses = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    if len(np.unique(ends, axis=0)) < len(ends) or (uses != 2).any():
        raise StageError("exporter step: the mesh is not closed or not oriented; a STEP solid must be")
    if (_normals(solid) == 0).all(axis=1).any():
        raise StageError("exporter step: the mesh has a triangle without area, which no plane can carry")


def add_triangles(file: Part21, solid: Solid) -> Ref:
    """The solid inside a closed mesh."""
    corners = [brep.corner(file, at) for at in solid.vertices]
    edges: dict[tuple[int, int], Ref] = {}
    faces = []
    for triangle, normal in zip(solid.faces.tolist(), _normals(solid), strict=True):
        loop = []
        for a, b in zip(triangle, (*triangle[1:], triangle[0]), strict=True):
            key = min(a, b), max(a, b)
            if key not in edges:
                edges[key] = brep.straight_edge(file, corners[key[0]], corners[key[1]])
            loop.append((edges[key], a < b))
        first, second = corners[triangle[0]], corners[triangle[1]]
        surface = brep.plane(file, first.point, normal, second.at - first.at)
        faces.append(brep.face(file, surface, loop))
    return brep.solid(file, faces)


def _normals(solid: Solid) -> FloatArray:
    """(F, 3) outward normals, as long as twice the area."""
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
