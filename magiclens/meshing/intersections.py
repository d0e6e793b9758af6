"""Does a solid cut through itself? By reasoning where its structure allows that, else by search."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from magiclens.config.optional import PYMESHLAB, is_installed
from magiclens.contract.artifacts import FloatArray, IntArray, Solid
from magiclens.geometry.solid import faces_in_parts

_TOLERANCES = 10
"""How far from a face, in manifold3d's tolerances, a point still lies on it."""
_COPLANAR = 1e-4
"""Sine of the angle below which two faces lie in one plane: on flat sides manifold3d moves points about."""


def faces_that_cut(solid: Solid) -> IntArray:
    """Indices (F,) of the faces that cut others, by pymeshlab, or by manifold3d where pymeshlab is not installed."""
    return faces_by_pymeshlab(solid) if is_installed(PYMESHLAB) else faces_by_manifold(solid)


def faces_by_pymeshlab(solid: Solid) -> IntArray:
    """Indices (F,) of the faces that cut others. On a million faces the search takes from seconds to minutes."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(solid.vertices, solid.faces))
    meshes.compute_selection_by_self_intersections_per_face()
    return np.flatnonzero(meshes.current_mesh().face_selection_array())


def faces_by_manifold(solid: Solid) -> IntArray:
    """Indices (F,) of the faces that cut others, found by the corners that the solid's union with itself gains.

    New corners lie where an edge passes a face. Faces that overlap in one plane, and cuts that are shallower than
    float32 can tell at the solid's size, are not found. The solid must be closed and consistently oriented.
    """
    from manifold3d import Manifold, Mesh

    body = Manifold(Mesh(solid.vertices.astype(np.float32), solid.faces.astype(np.uint32)))
    union = np.asarray((body + body).to_mesh().vert_properties)[:, :3]
    old = {point.tobytes() for point in solid.vertices.astype(np.float32)}
    new = [point.astype(np.float64) for point in union if point.tobytes() not in old]
    reach = _TOLERANCES * body.get_tolerance()
    corners = solid.vertices[solid.faces]
    low, high = corners.min(axis=1) - reach, corners.max(axis=1) + reach
    cut: set[int] = set()
    for point in new:
        near = np.flatnonzero(((low <= point) & (point <= high)).all(axis=1))
        if len(near):
            cut |= _crossing(solid.faces, corners, near[_distances(corners[near], point) <= reach])
    return np.array(sorted(cut), np.int64)


def _distances(triangles: FloatArray, point: FloatArray) -> FloatArray:
    """(F,) from a point to triangles (F, 3, 3)."""
    from trimesh.triangles import closest_point

    nearest = closest_point(triangles, np.broadcast_to(point, (len(triangles), 3)))
    return np.asarray(np.linalg.norm(nearest - point, axis=1))


def _crossing(faces: IntArray, corners: FloatArray, meeting: IntArray) -> set[int]:
    """Those of the faces meeting in a point that cross another one of them: neither coplanar nor neighbours."""
    normals = np.cross(*np.moveaxis(np.diff(corners[meeting], axis=1), 1, 0))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tilted = np.linalg.norm(np.cross(normals[:, None], normals), axis=2) > _COPLANAR
    shared = (faces[meeting][:, None, :, None] == faces[meeting][:, None, :]).sum(axis=(2, 3))
    return set(meeting[(tilted & (shared < 2)).any(axis=1)].tolist())


def cannot_cut_itself(solid: Solid) -> bool:
    """Whether the solid consists of a top and a floor below it, and sides that are seen edge-on or lean outward.

    Seen along the cutting rays, the triangles of top and floor all have the same orientation and their outlines are
    star-shaped. They then cover every point within the outline exactly once, so no ray meets either of them twice, and
    neither can cut itself. Sides that lean outward are seen from above and count with the top. Other sides may leave
    the rays by rounding, far less than the thinnest triangle measures. False when this is not so, which does not mean
    that the solid does cut itself. It must be closed and consistently oriented.
    """
    if solid.grid is None or (solid.eye_mm is not None and solid.vertices[:, 2].max() >= solid.eye_mm[2]):
        return False
    seen = _along_rays(solid.vertices, solid.eye_mm)
    below, lowest, thinnest = [], math.inf, math.inf
    for part in faces_in_parts(solid.faces):
        faces = solid.faces[part]
        is_top = faces.max(axis=1) < solid.grid[0] * solid.grid[1]
        top = faces[is_top]
        below.append(faces[~is_top])
        lowest = min(lowest, float(solid.vertices.take(top, axis=0)[..., 2].min(initial=math.inf)))
        thinnest = min(thinnest, _thinnest(seen.take(top, axis=0)))
    others = np.concatenate(below)
    on_top = others < solid.grid[0] * solid.grid[1]
    is_side = on_top.any(axis=1)
    sides, floor = others[is_side], others[~is_side]
    if len(others) == len(solid.faces) or not len(floor) or lowest <= solid.vertices[floor, 2].max():
        return False
    rims = _edges_of(sides, on_top[is_side])
    thinnest = min(thinnest, _thinnest(seen[floor[:, ::-1]]))
    off, across = _off_the_rays(seen[sides]), _altitudes(seen[sides])
    edge_on = 10 * off < thinnest
    thinnest = min(thinnest, float(across[~edge_on].min(initial=math.inf)))
    return 10 * float(off[edge_on].max(initial=0.0)) < thinnest and all(_is_star(seen[rim]) for rim in rims)


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
    """The smallest altitude of triangles (F, 3, 2), infinite if there are none; negative if one is clockwise."""
    return float(_altitudes(triangles).min(initial=math.inf))


def _altitudes(triangles: FloatArray) -> FloatArray:
    """(F,) the smallest altitude of each triangle (F, 3, 2); negative if it is clockwise."""
    a, b, c = (triangles[:, k] for k in range(3))
    double_area = _cross(b - a, c - a)
    longest = np.sqrt(np.maximum(np.maximum(_square(b - a), _square(c - b)), _square(a - c)))
    return np.asarray(double_area / longest)


def _off_the_rays(triangles: FloatArray) -> FloatArray:
    """(F,) by how much triangles (F, 3, 2) of the sides fail to be seen edge-on, with two corners on one ray."""
    a, b, c = (triangles[:, k] for k in range(3))
    return np.asarray(np.sqrt(np.min([_square(b - a), _square(c - b), _square(a - c)], axis=0)))


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
