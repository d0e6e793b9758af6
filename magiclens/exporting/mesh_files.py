"""Mesh files in millimetres, through trimesh. Vertices stay where they are; equal solids give equal bytes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from magiclens.contract.artifacts import FloatArray, IntArray, Scene, Solid
from magiclens.contract.stages import Exporter

if TYPE_CHECKING:
    from trimesh import Trimesh

STL_HEADER = b"magiclens, binary STL, unit: millimetre".ljust(80)
"""The first 80 bytes of an STL file. They must not begin with ``solid``, by which programs know STL files of text."""


class Stl(Exporter):
    """Binary STL: what every slicer reads. Float32 triangles, without shared vertices."""

    type: ClassVar[str] = "stl"
    suffix: ClassVar[str] = ".stl"

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write 84 + 50 F bytes."""
        write_stl(solid.vertices, solid.faces, path)


class Ply(Exporter):
    """Binary PLY: float32 vertices and faces that share them; less than half an STL file's size."""

    type: ClassVar[str] = "ply"
    suffix: ClassVar[str] = ".ply"

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write a header, 12 V + 13 F bytes."""
        from trimesh.exchange.ply import export_ply

        path.write_bytes(export_ply(_mesh(solid), encoding="binary", vertex_normal=False, include_attributes=False))


class Obj(Exporter):
    """Wavefront OBJ: text, for programs that read nothing else."""

    type: ClassVar[str] = "obj"
    suffix: ClassVar[str] = ".obj"

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write vertices with nine decimals, so to a picometre."""
        text = _mesh(solid).export(
            file_type="obj",
            include_normals=False,
            include_color=False,
            include_texture=False,
            digits=9,
            header="magiclens, unit: millimetre",
        )
        path.write_bytes(str(text).encode("ascii"))


def write_stl(vertices: FloatArray, faces: IntArray, path: Path) -> None:
    """Write triangles as binary STL: vertices (V, 3) mm, faces (F, 3)."""
    from trimesh import Trimesh
    from trimesh.exchange.stl import export_stl

    path.write_bytes(STL_HEADER + export_stl(Trimesh(vertices, faces, process=False))[len(STL_HEADER) :])


def _mesh(solid: Solid) -> Trimesh:
    """The solid as trimesh takes it, with nothing merged, dropped or reordered."""
    from trimesh import Trimesh

    return Trimesh(solid.vertices, solid.faces, process=False)
