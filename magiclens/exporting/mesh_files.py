"""Mesh files in millimetres. Vertices stay where they are; equal solids give equal bytes."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from magiclens.contract.artifacts import FloatArray, IntArray, Scene, Solid
from magiclens.contract.stages import Exporter
from magiclens.contract.units import Angle
from magiclens.geometry.decimation import decimated
from magiclens.geometry.solid import faces_in_parts

STL_HEADER = b"magiclens, binary STL, unit: millimetre".ljust(80)
"""The first 80 bytes of an STL file. They must not begin with ``solid``, by which programs know STL files of text."""

STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A triangle of an STL file, 50 bytes; the header and the number of triangles, 4 bytes, come before them."""
PLY_HEAD = b"""ply
format binary_little_endian 1.0
comment https://github.com/mikedh/trimesh
element vertex %d
property float x
property float y
property float z
element face %d
property list uchar int vertex_indices
end_header
"""
"""How a PLY file of ours begins; the numbers are those of vertices and faces."""
PLY_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
"""A face of a PLY file, 13 bytes."""
OBJ_HEAD = b"# magiclens, unit: millimetre\n"
"""How an OBJ file of ours begins."""
OBJ_VERTEX, OBJ_FACE = (b"v ", b" ", b" ", b"\n"), (b"f ", b" ", b" ", b"\n")
"""What is written around the numbers of each vertex and face; faces count vertices from 1."""
_PICOMETRE = 9
"""Number of decimals of coordinates in OBJ files, mm."""


class MeshExporter(Exporter):
    """An exporter of the mesh, whole or with fewer triangles.

    Attributes:
        triangle_bytes: About how large a file is, by its triangles, of which there are two for every vertex.
    """

    triangle_bytes: ClassVar[float]

    tolerance: Angle = Field(
        "0deg",
        validate_default=True,
        ge=0,
        le=5,
        description="leave out triangles inside facets as long as no normal turns by more, and no vertex is farther "
        "off than this angle times a micro-facet's width; 0deg: the whole mesh",
    )

    def mesh(self, scene: Scene, solid: Solid) -> Solid:
        """The mesh to write."""
        return decimated(solid, scene.lens, self.tolerance)


class Stl(MeshExporter):
    """Binary STL: what every slicer reads. Float32 triangles, without shared vertices."""

    type: ClassVar[str] = "stl"
    suffix: ClassVar[str] = ".stl"
    triangle_bytes: ClassVar[float] = 50

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write 84 + 50 F bytes."""
        mesh = self.mesh(scene, solid)
        write_stl(mesh.vertices, mesh.faces, path)


class Ply(MeshExporter):
    """Binary PLY: float32 vertices and faces that share them; less than half an STL file's size."""

    type: ClassVar[str] = "ply"
    suffix: ClassVar[str] = ".ply"
    triangle_bytes: ClassVar[float] = 19

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write a header, 12 V + 13 F bytes: those that trimesh writes, without the second that its import takes."""
        mesh = self.mesh(scene, solid)
        faces = np.empty(len(mesh.faces), PLY_FACE)
        faces["count"], faces["corners"] = 3, mesh.faces
        with path.open("wb") as file:
            file.write(PLY_HEAD % (len(mesh.vertices), len(faces)))
            file.write(mesh.vertices.astype("<f4").tobytes())
            file.write(faces.tobytes())


class Obj(MeshExporter):
    """Wavefront OBJ: text, for programs that read nothing else."""

    type: ClassVar[str] = "obj"
    suffix: ClassVar[str] = ".obj"
    triangle_bytes: ClassVar[float] = 43

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write vertices with up to nine decimals, so to a picometre, then faces."""
        from magiclens.exporting.digits import rounded_rows

        mesh = self.mesh(scene, solid)
        with path.open("wb") as file:
            file.write(OBJ_HEAD)
            file.writelines(rounded_rows(mesh.vertices, OBJ_VERTEX, _PICOMETRE))
            file.writelines(rounded_rows(mesh.faces + 1, OBJ_FACE))


def write_stl(vertices: FloatArray, faces: IntArray, path: Path) -> None:
    """Write triangles as binary STL: vertices (V, 3) mm, faces (F, 3)."""
    with path.open("wb") as file:
        file.write(STL_HEADER + struct.pack("<I", len(faces)))
        for part in faces_in_parts(faces):
            file.write(_stl_triangles(vertices.take(faces[part], axis=0)).tobytes())


def _stl_triangles(corners: FloatArray) -> NDArray[np.void]:
    """Triangles (F, 3, 3) with their unit normals; those without area have none."""
    edges = np.diff(corners, axis=1)
    across = np.cross(edges[:, 0], edges[:, 1])
    double_area = np.sqrt(np.einsum("ij,ij->i", across, across))
    triangles = np.zeros(len(corners), STL_TRIANGLE)
    with np.errstate(divide="ignore", invalid="ignore"):
        triangles["normal"], triangles["corners"] = across * (1.0 / double_area)[:, None], corners
    triangles["normal"][double_area == 0] = 0.0
    return triangles
