"""Checks of closed meshes."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray


def assert_closed(vertices: FloatArray, faces: IntArray) -> None:
    """Fail unless a mesh is closed and its normals point outward.

    Args:
        vertices: (V, 3), in any unit.
        faces: (F, 3), indices of vertices.
    """
    import trimesh

    mesh = trimesh.Trimesh(np.asarray(vertices), np.asarray(faces), process=False)
    assert mesh.is_watertight, "the mesh is not closed: some edges belong to one face alone"
    assert mesh.is_winding_consistent, "neighbouring faces have opposite orientations"
    assert mesh.volume > 0, "the normals point inward"


def volume_mm3(vertices: FloatArray, faces: IntArray) -> float:
    """Volume of a closed mesh, mm^3.

    Args:
        vertices: (V, 3), mm.
        faces: (F, 3), indices of vertices, counter-clockwise seen from outside.
    """
    # each face and the origin make a tetrahedron of signed volume a . (b x c) / 6; what lies outside the mesh cancels
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)
