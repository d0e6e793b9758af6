"""Does a solid cut through itself? By reasoning where its structure allows that, else by pymeshlab's search."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, IntArray, Solid


def faces_that_cut(solid: Solid) -> IntArray:
    """Indices of the faces that cut others. On a million faces the search takes from seconds to minutes."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(solid.vertices, solid.faces))
    meshes.compute_selection_by_self_intersections_per_face()
    return np.flatnonzero(meshes.current_mesh().face_selection_array())


def cannot_cut_itself(solid: Solid) -> bool:
    """Whether the solid consists of a top and a floor below it, joined by sides that are seen edge-on.

    Seen along the cutting rays, the triangles of top and floor all have the same orientation and their outlines are
    star-shaped. They then cover every point within the outline exactly once, so no ray meets either of them twice, and
    neither can cut itself. Sides may leave the rays by rounding, far less than the thinnest triangle measures. False
    when this is not so, which does not mean that the solid does cut itself. It must be closed and consistently
    oriented.
    """
    if solid.grid is None or (solid.eye_mm is not None and solid.vertices[:, 2].max() >= solid.eye_mm[2]):
        return False
    seen = _along_rays(solid.vertices, solid.eye_mm)
    on_top = solid.faces < solid.grid[0] * solid.grid[1]
    count = on_top.sum(axis=1)
    top, sides, floor = solid.faces[count == 3], solid.faces[(count > 0) & (count < 3)], solid.faces[count == 0]
    if not len(top) or not len(floor) or solid.vertices[top, 2].min() <= solid.vertices[floor, 2].max():
        return False
    rims = _edges_of(sides, on_top[(count > 0) & (count < 3)])
    thinnest = min(_thinnest(seen[top]), _thinnest(seen[floor[:, ::-1]]))
    return 10 * _off_the_rays(seen[sides]) < thinnest and all(_is_star(seen[rim]) for rim in rims)


def _along_rays(points: FloatArray, eye: FloatArray | None) -> FloatArray:
    """(V, 2): where the rays through points meet the plane z = 0; x and y if they are vertical."""
    if eye is None:
        return points[:, :2]
    seen: FloatArray = eye[:2] + (points[:, :2] - eye[:2]) * (eye[2] / (eye[2] - points[:, 2:]))
    return seen


def _edges_of(sides: IntArray, on_top: NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
    """The outlines of the top and of the floor as directed edges (E, 2), counter-clockwise as the eye sees them."""
    start, end = sides.ravel(), np.roll(sides, -1, axis=1).ravel()
    start_on_top, end_on_top = on_top.ravel(), np.roll(on_top, -1, axis=1).ravel()
    edges = np.stack([start, end], axis=-1)
    return edges[start_on_top & end_on_top][:, ::-1], edges[~start_on_top & ~end_on_top]


def _thinnest(triangles: FloatArray) -> float:
    """The smallest altitude of triangles (F, 3, 2); negative if one of them is clockwise."""
    a, b, c = (triangles[:, k] for k in range(3))
    double_area = _cross(b - a, c - a)
    longest = np.sqrt(np.max([_square(b - a), _square(c - b), _square(a - c)], axis=0))
    return float((double_area / longest).min())


def _off_the_rays(triangles: FloatArray) -> float:
    """By how much the triangles (F, 3, 2) of the sides fail to be seen edge-on: each has two corners on one ray."""
    a, b, c = (triangles[:, k] for k in range(3))
    return float(np.sqrt(np.min([_square(b - a), _square(c - b), _square(a - c)], axis=0)).max())


def _is_star(edges: FloatArray) -> bool:
    """Whether directed edges (E, 2, 2) go around their centre once, and never back."""
    a, b = np.moveaxis(edges - edges.mean(axis=(0, 1)), 1, 0)
    angles = np.arctan2(_cross(a, b), np.einsum("ij,ij->i", a, b))
    return bool(angles.min() > 0) and math.isclose(angles.sum(), 2 * math.pi, rel_tol=1e-6)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    cross: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return cross


def _square(a: FloatArray) -> FloatArray:
    square: FloatArray = np.einsum("ij,ij->i", a, a)
    return square
