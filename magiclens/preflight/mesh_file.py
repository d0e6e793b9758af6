"""The mesh files of a run folder, read back as other programs read them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree.ElementTree import iterparse
from zipfile import ZipFile

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Lens, Solid
from magiclens.exporting.digits import numbers_of
from magiclens.exporting.mesh_files import OBJ_FACE, OBJ_HEAD, OBJ_VERTEX, PLY_FACE, PLY_HEAD
from magiclens.exporting.three_mf import MODEL, TRIANGLE, VERTEX

_SUFFIXES = ("stl", "ply", "glb", "3mf", "obj")
"""Suffixes of mesh files, those that are quick to read first."""
BOTTOM_MM = 1e-4
"""Height up to which vertices belong to the flat bottom, mm; floats in files are not exactly 0."""
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A triangle of a binary STL file, 50 bytes; 80 bytes of text and the number of triangles come before them."""
_PLY_COUNTS = re.compile(rb"ply\n.*?element vertex (\d{1,10})\n.*?element face (\d{1,10})\n", re.DOTALL)
"""The numbers of vertices and faces in the header of a PLY file."""
_NANOMETRE_MM = 1e-6
"""To what coordinates of 3MF are rounded."""
_LONGEST = 2.0
"""Longest edge of a divided triangle, in micro-facets."""
_HASH_FACTORS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)
"""Odd numbers by which x, y and z are multiplied to hash a point."""


@dataclass(frozen=True)
class MeshFile:
    """The triangles of a mesh file.

    Attributes:
        path: The file.
        triangles: (F, 3, 3) float32 corners, mm, lens frame, counter-clockwise as seen from outside if the file is
            right.
    """

    path: Path
    triangles: FloatArray

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    @cached_property
    def extent_mm(self) -> FloatArray:
        """(2, 3) lowest and highest x, y and z, mm."""
        axes = [self.triangles[..., k] for k in range(3)]
        return np.array([[axis.min() for axis in axes], [axis.max() for axis in axes]], np.float64)

    @cached_property
    def volume_mm3(self) -> float:
        """The volume by the divergence theorem; positive if faces point outward."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        # the float32 of the file is exact enough for products, but not for their sum
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum(dtype=np.float64) / 6)

    @cached_property
    def on_top(self) -> IntArray:
        """Indices of the triangles that have no corner on the flat bottom."""
        return np.flatnonzero(np.minimum.reduce(np.moveaxis(self.triangles[..., 2], 1, 0)) > BOTTOM_MM)

    def mirrored(self) -> MeshFile:
        """The body mirrored in the plane x = 0."""
        # reversing the corners keeps the faces pointing outward
        swapped = (self.triangles * np.array([-1, 1, 1], np.float32))[:, ::-1]
        return MeshFile(self.path, np.ascontiguousarray(swapped))

    def as_fine_as(self, lens: Lens) -> MeshFile:
        """The body with large triangles of its top divided, if it has fewer than the lens has micro-facets.

        Rays are followed through the middles of triangles only, so these must lie everywhere.
        """
        if len(self.on_top) >= 2 * (lens.facets * lens.microfacets) ** 2:
            return self
        from trimesh.remesh import subdivide_to_size

        top = self.triangles[self.on_top].astype(np.float64)
        longest = _LONGEST * lens.pitch_mm / lens.microfacets
        points, faces = subdivide_to_size(top.reshape(-1, 3), np.arange(3 * len(top)).reshape(-1, 3), longest, 20)
        others = np.delete(self.triangles, self.on_top, axis=0)
        return MeshFile(self.path, np.concatenate([points[faces].astype(np.float32), others]))

    def same_as(self, solid: Solid) -> bool:
        """Whether the file holds the faces of a solid in the same order, each coordinate rounded as files round it."""
        if len(self.triangles) != len(solid.faces):
            return False
        wanted = solid.vertices.astype(np.float32)
        near = np.spacing(np.abs(wanted)) + np.float32(_NANOMETRE_MM)
        return all(
            bool((np.abs(wanted[ends] - self.triangles[:, k]) <= near[ends]).all())
            for k, ends in enumerate(solid.faces.T)
        )

    def solid(self, eye_mm: FloatArray | None) -> Solid:
        """The closed mesh that the triangles form when equal corners are joined; vertices of the top come first.

        Its grid says only how many vertices belong to the top, not how they lie, so the built-in tracer cannot use it.

        Args:
            eye_mm: (3,) eye along whose rays the top was cut; None for vertical cells.
        """
        corners = self.triangles.reshape(-1, 3) + np.float32(0)  # turns -0 into 0, which has other bits
        first, index = _distinct(corners)
        vertices = corners[first].astype(np.float64)
        low = vertices[:, 2] <= BOTTOM_MM
        order = np.argsort(low, kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))  # the inverse of ``order``: where each vertex goes
        faces = rank[index].reshape(-1, 3).astype(np.int32)
        return Solid(vertices[order], faces, (int((~low).sum()), 1), eye_mm)


def read_mesh_file(path: Path) -> MeshFile:
    """Read an STL, PLY, GLB, 3MF or OBJ file. Raises ValueError if it is broken; other readers raise other errors."""
    if path.suffix == ".stl":
        content = path.read_bytes()
        count = int.from_bytes(content[80:84], "little")
        if len(content) != 84 + _STL.itemsize * count:
            raise ValueError(f"{path.name} is cut short or is not binary STL")
        return MeshFile(path, np.ascontiguousarray(np.frombuffer(content, _STL, count, 84)["corners"]))
    if path.suffix == ".3mf":
        return MeshFile(path, _three_mf(path))
    if path.suffix == ".ply" and (triangles := _own_ply(path.read_bytes())) is not None:
        return MeshFile(path, triangles)
    if path.suffix == ".obj" and (triangles := _own_obj(path.read_bytes())) is not None:
        return MeshFile(path, triangles)
    from trimesh import load_mesh

    mesh = load_mesh(str(path), process=False)
    triangles = np.asarray(mesh.triangles)
    if path.suffix == ".glb":  # glTF is in metres and has +y up
        x, up, away = np.moveaxis(triangles * 1000, -1, 0)
        triangles = np.stack([x, -away, up], axis=-1)
    return MeshFile(path, triangles.astype(np.float32))


def _own_ply(content: bytes) -> FloatArray | None:
    """(F, 3, 3) float32: the triangles of a PLY file as our exporter writes it; None if somebody else has.

    Raises ValueError if it was damaged since.
    """
    counts = _PLY_COUNTS.match(content)
    if counts is None:
        return None
    vertices, faces = map(int, counts.groups())
    head = PLY_HEAD % (vertices, faces)
    if not content.startswith(head) or len(content) != len(head) + 12 * vertices + PLY_FACE.itemsize * faces:
        return None
    points = np.frombuffer(content, "<f4", 3 * vertices, len(head)).reshape(-1, 3)
    listed = np.frombuffer(content, PLY_FACE, faces, len(head) + points.nbytes)
    if (listed["count"] != 3).any():
        raise ValueError("its faces are not triangles")
    return _triangles(points, listed["corners"])


def _own_obj(content: bytes) -> FloatArray | None:
    """(F, 3, 3) float32: the triangles of an OBJ file as our exporter writes it; None if somebody else has."""
    end = content.find(b"\n%s" % OBJ_FACE[0]) + 1
    if not content.startswith(OBJ_HEAD) or end < len(OBJ_HEAD):
        return None
    vertices, faces = numbers_of(content[len(OBJ_HEAD) : end], OBJ_VERTEX), numbers_of(content[end:], OBJ_FACE)
    return None if vertices is None or faces is None else _triangles(vertices, faces.astype(np.int64) - 1)


def _triangles(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(F, 3, 3) float32: the corners of faces. Raises ValueError if there are no such vertices."""
    if ((faces < 0) | (faces >= len(vertices))).any():
        raise ValueError("its faces name vertices that are not there")
    triangles: FloatArray = vertices.astype(np.float32)[faces]
    return triangles


def _three_mf(path: Path) -> FloatArray:
    """(F, 3, 3) float32: the triangles of the one mesh of a 3MF package in millimetres, without its placement."""
    with ZipFile(path) as archive:
        return _triangles(*(_own_three_mf(archive.read(MODEL)) or _any_three_mf(archive)))


def _own_three_mf(model: bytes) -> tuple[FloatArray, IntArray] | None:
    """Vertices (V, 3) and faces (F, 3) of a model as our exporter writes it; None if somebody else has."""
    blocks = (_block(model, b"vertices"), _block(model, b"triangles"))
    vertices, faces = (numbers_of(text, row) for text, row in zip(blocks, (VERTEX, TRIANGLE), strict=True))
    return None if vertices is None or faces is None else (vertices, faces.astype(np.int64))


def _block(model: bytes, name: bytes) -> bytes:
    """The rows between the tags of an element; text that holds no rows if the tags are not as we write them."""
    begin, end = model.find(b"<%s>\n" % name), model.find(b"</%s>" % name)
    return model[begin + len(name) + 3 : end] if 0 <= begin < end else b" "


def _any_three_mf(archive: ZipFile) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and faces (F, 3) of a model by an XML parser, which takes twenty times as long."""
    vertices: list[tuple[float, ...]] = []
    faces: list[tuple[int, ...]] = []
    with archive.open(MODEL) as model:
        for _, element in iterparse(model):
            tag = element.tag.rpartition("}")[2]
            if tag == "vertex":
                vertices.append(tuple(float(element.attrib[axis]) for axis in "xyz"))
            elif tag == "triangle":
                faces.append(tuple(int(element.attrib[corner]) for corner in ("v1", "v2", "v3")))
            element.clear()  # else the whole document would stay in memory
    return np.array(vertices), np.array(faces)


def mesh_files(folder: Path) -> list[Path]:
    """The mesh files of a run folder, those that are quick to read first."""
    return [path for path in (folder / f"lens.{suffix}" for suffix in _SUFFIXES) if path.is_file()]


def _distinct(points: FloatArray) -> tuple[IntArray, IntArray]:
    """Find equal points among (P, 3) float32.

    Returns:
        (D,) index of the first of each group of equal points, and (P,) the group of each point.
    """
    bits = np.ascontiguousarray(points, np.float32).view(np.uint32).astype(np.uint64)
    # sorting one hash per point is much faster than sorting rows
    mixed = (bits * np.array(_HASH_FACTORS, np.uint64)).sum(axis=1, dtype=np.uint64)
    _, first, index = np.unique(mixed ^ (mixed >> np.uint64(29)), return_index=True, return_inverse=True)
    if not (points[first][index] == points).all():  # different points had one hash
        _, first, index = np.unique(points, axis=0, return_index=True, return_inverse=True)
    return first, index.ravel()
