"""Smoothing that changes heights only, and only by a little, so that it cannot cost the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, Lens, Solid
from magiclens.geometry.solid import facet_faces, top_faces


def smoothed(solid: Solid, lens: Lens, bound_mm: float, iterations: int) -> tuple[Solid, float]:
    """The solid after Taubin smoothing inside its facets.

    Every vertex stays on its ray from ``solid.eye_mm``, or on its vertical. The edges of the facets, the walls between
    them and the rim do not move.

    Args:
        solid: it must have the grid of the lens.
        lens: the lens that the solid was made for.
        bound_mm: how far a vertex may move along its ray, mm.
        iterations: passes of Taubin smoothing.

    Returns:
        The smoothed solid, and how far the vertex that moved most has moved, mm.
    """
    assert solid.grid is not None
    top = solid.vertices[: solid.grid[0] * solid.grid[1]]
    moved = _taubin(top, top_faces(*solid.grid), facet_faces(lens), iterations) - top
    rays = _rays(top, solid.eye_mm)
    normals = _normals(top.reshape(*solid.grid, 3)).reshape(-1, 3)
    # What counts is how far the surface moves off itself: sliding along it changes no height.
    along = np.einsum("ij,ij->i", moved, normals) / np.einsum("ij,ij->i", rays, normals)
    along = np.clip(along, -bound_mm, bound_mm)
    vertices = np.concatenate([top + along[:, None] * rays, solid.vertices[len(top) :]])
    return Solid(vertices, solid.faces, solid.grid, solid.eye_mm, dict(solid.metrics)), float(np.abs(along).max())


def _taubin(vertices: FloatArray, faces: NDArray[np.integer], inside: NDArray[np.bool_], iterations: int) -> FloatArray:
    """The vertices after smoothing those that touch no other faces than the ones ``inside``."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces, f_scalar_array=inside.astype(np.float64)))
    meshes.compute_selection_by_condition_per_face(condselect="fq > 0.5")
    meshes.apply_coord_taubin_smoothing(stepsmoothnum=iterations, selected=True)
    return np.asarray(meshes.current_mesh().vertex_matrix(), np.float64)


def _rays(points: FloatArray, eye: FloatArray | None) -> FloatArray:
    """Unit vectors along which points may move."""
    if eye is None:
        return np.broadcast_to(np.array([0.0, 0.0, 1.0]), points.shape)
    rays: FloatArray = points - eye
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return rays


def _normals(surface: FloatArray) -> FloatArray:
    """Normals (of any length) of a grid of points (rows, columns, 3)."""
    down, right = np.gradient(surface, axis=(0, 1))
    return np.cross(down, right)
