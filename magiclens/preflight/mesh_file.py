"""The mesh files of a run folder, read back as other programs read them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol
from xml.etree.ElementTree import iterparse
from zipfile import ZipFile

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Lens, Solid
from magiclens.exporting.digits import numbers_of
from magiclens.exporting.mesh_files import (
    OBJ_FACE,
    OBJ_HEAD,
    OBJ_VERTEX,
    PLY_FACE,
    PLY_HEAD,
    STL_HEADER,
    STL_TRIANGLE,
)
from magiclens.exporting.three_mf import MODEL, TRIANGLE, VERTEX
from magiclens.geometry.solid import faces_in_parts

_SUFFIXES = ("stl", "ply", "glb", "3mf", "obj")
"""Suffixes of mesh files, those that are quick to read first."""
BOTTOM_MM = 1e-4
"""Height up to which vertices belong to the flat bottom, mm; floats in files are not exactly 0."""
_STL_HEAD_BYTES = len(STL_HEADER) + 4
"""Where the triangles of an STL file begin: the number of them is 4 bytes."""
_PLY_COUNTS = re.compile(rb"ply\n.*?element vertex (\d{1,10})\n.*?element face (\d{1,10})\n", re.DOTALL)
"""The numbers of vertices and faces in the header of a PLY file."""
_NANOMETRE_MM = 1e-6
"""To what coordinates of 3MF are rounded."""
_LONGEST = 2.0
"""Longest edge of a divided triangle, in micro-facets."""
_HASH_FACTORS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)
"""Odd numbers by which x, y and z are multiplied to hash a point."""


class MeshTriangles(Protocol):
    """Triangles of which a few at a time are in memory; an array (F, 3, 3) float32 holds all of them."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> FloatArray:
        """(P, 3, 3) float32 corners, mm."""


@dataclass(frozen=True)
class SharedCorners:
    """Triangles that share their corners.

    Attributes:
        vertices: (V, 3) float32, mm.
        faces: (F, 3) indices of the corners.
    """

    vertices: FloatArray
    faces: IntArray

    def __len__(self) -> int:
        return len(self.faces)

    def __getitem__(self, part: slice) -> FloatArray:
        return self.vertices.take(self.faces[part], axis=0)


@dataclass(frozen=True)
class _InStl:
    """So many triangles in a binary STL file."""

    path: Path
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, part: slice) -> FloatArray:
        first, end, _ = part.indices(self.count)
        at = _STL_HEAD_BYTES + STL_TRIANGLE.itemsize * first
        return np.ascontiguousarray(np.fromfile(self.path, STL_TRIANGLE, end - first, offset=at)["corners"])


@dataclass(frozen=True)
class MeshFile:
    """The triangles of a mesh file.

    Attributes:
        path: The file.
        triangles: Their corners, mm, lens frame, counter-clockwise as seen from outside if the file is right.
    """

    path: Path
    triangles: MeshTriangles

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    @property
    def extent_mm(self) -> FloatArray:
        """(2, 3) lowest and highest x, y and z, mm."""
        return self._measured[0]

    @property
    def volume_mm3(self) -> float:
        """The volume by the divergence theorem; positive if faces point outward."""
        return self._measured[1]

    @property
    def top_count(self) -> int:
        """Number of the triangles that have no corner on the flat bottom."""
        return self._measured[2]

    @cached_property
    def _measured(self) -> tuple[FloatArray, float, int]:
        """``extent_mm``, ``volume_mm3`` and ``top_count``."""
        low, high, sixfold, top_count = np.full(3, np.inf), np.full(3, -np.inf), 0.0, 0
        for triangles in self._parts():
            axes = [triangles[..., k] for k in range(3)]
            low = np.minimum(low, [axis.min() for axis in axes])
            high = np.maximum(high, [axis.max() for axis in axes])
            a, b, c = np.moveaxis(triangles, 1, 0)
            # the float32 of the file is exact enough for products, but not for their sum
            sixfold += float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum(dtype=np.float64))
            top_count += int(_is_top(triangles).sum())
        return np.array([low, high]), sixfold / 6, top_count

    def _parts(self) -> Iterator[FloatArray]:
        return (self.triangles[part] for part in faces_in_parts(self.triangles))

    def top_parts(self, lens: Lens) -> Iterator[FloatArray]:
        """The triangles that have no corner on the flat bottom, some at a time.

        Large ones are divided if there are fewer than the lens has micro-facets: rays are followed through the middles
        of triangles only, so these must lie everywhere.

        Yields:
            (P, 3, 3) float32 corners, mm.
        """
        few = self.top_count < 2 * (lens.facets * lens.microfacets) ** 2
        for triangles in self._parts():
            top = triangles[_is_top(triangles)]
            yield _divided(top, _LONGEST * lens.pitch_mm / lens.microfacets) if few and len(top) else top

    def same_as(self, solid: Solid) -> bool:
        """Whether the file holds the faces of a solid in the same order, each coordinate rounded as files round it."""
        wanted = SharedCorners(solid.vertices.astype(np.float32), solid.faces)
        return len(self.triangles) == len(wanted) and all(
            _is_near(self.triangles[part], wanted[part]) for part in faces_in_parts(wanted)
        )

    def solid(self, eye_mm: FloatArray | None) -> Solid:
        """The closed mesh that the triangles form when equal corners are joined; vertices of the top come first.

        Its grid says only how many vertices belong to the top, not how they lie, so the built-in tracer cannot use it.

        Args:
            eye_mm: (3,) eye along whose rays the top was cut; None for vertical cells.
        """
        corners = self.triangles[:].reshape(-1, 3) + np.float32(0)  # turns -0 into 0, which has other bits
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
    return MeshFile(path, _read(path))


def _read(path: Path) -> MeshTriangles:
    if path.suffix == ".stl":
        with path.open("rb") as file:
            count = int.from_bytes(file.read(_STL_HEAD_BYTES)[len(STL_HEADER) :], "little")
        if path.stat().st_size != _STL_HEAD_BYTES + STL_TRIANGLE.itemsize * count:
            raise ValueError(f"{path.name} is cut short or is not binary STL")
        return _InStl(path, count)
    if path.suffix == ".3mf":
        return _three_mf(path)
    if path.suffix == ".ply" and (triangles := _own_ply(path.read_bytes())) is not None:
        return triangles
    if path.suffix == ".obj" and (triangles := _own_obj(path.read_bytes())) is not None:
        return triangles
    from trimesh import load_mesh

    mesh = load_mesh(str(path), process=False)
    points = np.asarray(mesh.vertices)
    if path.suffix == ".glb":  # glTF is in metres and has +y up
        x, up, away = points.T * 1000
        points = np.stack([x, -away, up], axis=-1)
    return _shared(points, np.asarray(mesh.faces))


def _own_ply(content: bytes) -> SharedCorners | None:
    """The triangles of a PLY file as our exporter writes it; None if somebody else has.

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
    return _shared(points, listed["corners"])


def _own_obj(content: bytes) -> SharedCorners | None:
    """The triangles of an OBJ file as our exporter writes it; None if somebody else has."""
    end = content.find(b"\n%s" % OBJ_FACE[0]) + 1
    if not content.startswith(OBJ_HEAD) or end < len(OBJ_HEAD):
        return None
    vertices = numbers_of(content, OBJ_VERTEX, len(OBJ_HEAD), end)
    faces = numbers_of(content, OBJ_FACE, end)
    return None if vertices is None or faces is None else _shared(vertices, faces - 1)


def _shared(vertices: FloatArray, faces: FloatArray | IntArray) -> SharedCorners:
    """Triangles by vertices (V, 3) and indices (F, 3) of them. Raises ValueError if there are no such vertices."""
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise ValueError("its faces name vertices that are not there")
    return SharedCorners(vertices.astype(np.float32), faces.astype(np.int32))


def _three_mf(path: Path) -> SharedCorners:
    """The triangles of the one mesh of a 3MF package in millimetres, without its placement."""
    with ZipFile(path) as archive:
        return _shared(*(_own_three_mf(archive.read(MODEL)) or _any_three_mf(archive)))


def _own_three_mf(model: bytes) -> tuple[FloatArray, FloatArray] | None:
    """Vertices (V, 3) and faces (F, 3) of a model as our exporter writes it; None if somebody else has."""
    vertices = numbers_of(model, VERTEX, *_block(model, b"vertices"))
    faces = numbers_of(model, TRIANGLE, *_block(model, b"triangles"))
    return None if vertices is None or faces is None else (vertices, faces)


def _block(model: bytes, name: bytes) -> tuple[int, int]:
    """First and end of the rows between the tags of an element; of no rows if the tags are not as we write them."""
    begin, end = model.find(b"<%s>\n" % name), model.find(b"</%s>" % name)
    return (begin + len(name) + 3, end) if 0 <= begin < end else (0, 1)


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


def mirrored_triangles(triangles: FloatArray) -> FloatArray:
    """Triangles (F, 3, 3) mirrored in the plane x = 0."""
    # reversing the corners keeps the faces pointing outward
    flipped: FloatArray = triangles[:, ::-1].copy()
    flipped[..., 0] *= -1
    return flipped


def _is_top(triangles: FloatArray) -> BoolArray:
    """(F,) whether triangles (F, 3, 3) have no corner on the flat bottom."""
    a, b, c = triangles[..., 2].T
    return np.asarray((a > BOTTOM_MM) & (b > BOTTOM_MM) & (c > BOTTOM_MM))


def _is_near(found: FloatArray, wanted: FloatArray) -> bool:
    """Whether coordinates are those of float32, or these rounded to nanometres."""
    if np.array_equal(found, wanted):
        return True
    return bool((np.abs(wanted - found) <= np.spacing(np.abs(wanted)) + np.float32(_NANOMETRE_MM)).all())


def _divided(triangles: FloatArray, longest_mm: float) -> FloatArray:
    """Triangles (F, 3, 3) float32 whose edges are not longer, in the place of larger ones."""
    from trimesh.remesh import subdivide_to_size

    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    points, faces = subdivide_to_size(triangles.reshape(-1, 3).astype(np.float64), corners, longest_mm, 20)
    return SharedCorners(np.asarray(points, np.float32), faces)[:]


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
