"""Mesh files hold the solid as it is, whoever reads them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from fabricated import bumpy, written
from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.contract.stages import Exporter
from magiclens.exporting.mesh_files import Obj, Ply, Stl, write_stl
from magiclens.geometry import solid as solid_module
from magiclens.preflight.mesh_file import read_mesh_file

EXPORTERS = [Stl(), Ply(), Obj()]
every_format = pytest.mark.parametrize("exporter", EXPORTERS, ids=[e.type for e in EXPORTERS])


def corners_read(path: Path) -> FloatArray:
    """(F, 3, 3): the triangles that trimesh reads."""
    import trimesh

    mesh = trimesh.load_mesh(path, process=False)
    corners: FloatArray = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    return corners


@every_format
def test_file_holds_every_triangle_in_its_place_and_order(exporter: Exporter, tmp_path: Path) -> None:
    mesh = bumpy()
    expected = mesh.vertices[mesh.faces]
    assert np.abs(corners_read(written(exporter, tmp_path, mesh)) - expected).max() < 5e-7


@pytest.mark.parametrize("exporter", [Stl(), Ply()], ids=["stl", "ply"])
def test_binary_files_hold_vertices_rounded_to_float32_and_nothing_else(exporter: Exporter, tmp_path: Path) -> None:
    mesh = bumpy()
    expected = mesh.vertices.astype(np.float32)[mesh.faces]
    assert np.array_equal(corners_read(written(exporter, tmp_path, mesh)), expected)


def test_obj_holds_what_float32_would_round(tmp_path: Path) -> None:
    mesh = bumpy()
    assert np.abs(corners_read(written(Obj(), tmp_path, mesh)) - mesh.vertices[mesh.faces]).max() < 1e-9


@pytest.mark.parametrize("exporter", [Ply(), Obj()], ids=["ply", "obj"])
def test_vertices_that_faces_share_are_written_once(exporter: Exporter, tmp_path: Path) -> None:
    import trimesh

    mesh = bumpy()
    read = trimesh.load_mesh(written(exporter, tmp_path, mesh), process=False)
    assert len(read.vertices) == len(mesh.vertices)
    assert np.array_equal(read.faces, mesh.faces)


@every_format
def test_vertices_in_one_place_are_not_merged(exporter: Exporter, tmp_path: Path) -> None:
    mesh = bumpy()
    collapsed = mesh.vertices.copy()
    collapsed[1] = collapsed[0]
    corners = corners_read(written(exporter, tmp_path, Solid(collapsed, mesh.faces)))
    assert len(corners) == len(mesh.faces)


@every_format
def test_equal_solids_give_equal_bytes_and_others_do_not(exporter: Exporter, tmp_path: Path) -> None:
    moved = bumpy().vertices.copy()
    moved[0, 2] += 1e-4
    paths = [
        written(exporter, tmp_path / name, mesh)
        for name, mesh in (("one", bumpy()), ("same", bumpy()), ("other", Solid(moved, bumpy().faces)))
    ]
    one, same, other = (hashlib.sha256(p.read_bytes()).hexdigest() for p in paths)
    assert one == same
    assert one != other


@every_format
def test_other_programs_read_the_same_volume(exporter: Exporter, tmp_path: Path) -> None:
    import pymeshlab

    mesh = bumpy()
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(written(exporter, tmp_path, mesh)))
    meshes.meshing_remove_duplicate_vertices()
    assert meshes.get_geometric_measures()["mesh_volume"] == pytest.approx(mesh.metrics["volume_mm3"], rel=1e-6)
    assert meshes.get_topological_measures()["is_mesh_two_manifold"]


def test_stl_is_binary_with_a_pinned_header_and_outward_normals(tmp_path: Path) -> None:
    mesh = bumpy()
    data = written(Stl(), tmp_path, mesh).read_bytes()
    assert data[:80].rstrip() == b"magiclens, binary STL, unit: millimetre"
    assert not data.startswith(b"solid")
    assert int.from_bytes(data[80:84], "little") == len(mesh.faces)
    assert len(data) == 84 + 50 * len(mesh.faces)
    normals = np.frombuffer(data[84:], np.dtype([("normal", "<f4", 3), ("rest", "V38")]))["normal"]
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    assert np.einsum("ij,ij->i", normals, across) == pytest.approx(np.linalg.norm(across, axis=1), rel=1e-5)


def test_an_stl_file_that_is_written_in_parts_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solid = bumpy()
    write_stl(solid.vertices, solid.faces, tmp_path / "whole.stl")
    monkeypatch.setattr(solid_module, "FACES_AT_ONCE", 7)
    write_stl(solid.vertices, solid.faces, tmp_path / "parts.stl")
    assert (tmp_path / "parts.stl").read_bytes() == (tmp_path / "whole.stl").read_bytes()


def test_ply_has_the_bytes_that_trimesh_writes(tmp_path: Path) -> None:
    from trimesh import Trimesh
    from trimesh.exchange.ply import export_ply

    mesh = bumpy()
    wanted = export_ply(
        Trimesh(mesh.vertices, mesh.faces, process=False), vertex_normal=False, include_attributes=False
    )
    assert written(Ply(), tmp_path, mesh).read_bytes() == wanted


@pytest.mark.parametrize(
    ("exporter", "sign"), [(Ply(), b"mikedh"), (Obj(), b"magiclens"), (Obj(), b"\nf ")], ids=["ply", "obj", "rows"]
)
@pytest.mark.parametrize("other", [False, True])
def test_files_are_read_back_as_by_trimesh(exporter: Exporter, sign: bytes, other: bool, tmp_path: Path) -> None:
    """Our own files at once, and others, here by a letter more, by trimesh."""
    path = written(exporter, tmp_path, bumpy())
    if other:
        path.write_bytes(path.read_bytes().replace(sign, sign + b" "))
    assert np.array_equal(read_mesh_file(path).triangles[:], corners_read(path).astype(np.float32))


@pytest.mark.parametrize("face", [b"f 1 2 0", b"f 1 2 999999", b"f 1 2 -1000000"])
def test_obj_with_faces_of_other_vertices_is_not_read(face: bytes, tmp_path: Path) -> None:
    path = written(Obj(), tmp_path, bumpy())
    rows = path.read_bytes().splitlines()
    path.write_bytes(b"\n".join([*rows[:-1], face, b""]))
    with pytest.raises(ValueError, match="vertices that are not there"):
        read_mesh_file(path)


@pytest.mark.parametrize("damage", ["cut", "face of four", "beyond", "before"])
def test_damaged_ply_is_not_read(damage: str, tmp_path: Path) -> None:
    path = written(Ply(), tmp_path, bumpy())
    content = bytearray(path.read_bytes())
    content[-13:] = {
        "cut": b"", "face of four": b"\4" + bytes(12), "beyond": b"\3" + b"\x7f" * 12, "before": b"\3" + b"\xff" * 12
    }[damage]  # fmt: skip
    path.write_bytes(content)
    with pytest.raises((ValueError, IndexError)):  # the last of trimesh, which is asked about a file that is cut
        read_mesh_file(path)


def test_ply_is_binary_and_has_no_normals(tmp_path: Path) -> None:
    mesh = bumpy()
    head, body = written(Ply(), tmp_path, mesh).read_bytes().split(b"end_header\n")
    assert b"format binary_little_endian" in head
    assert len(body) == 12 * len(mesh.vertices) + 13 * len(mesh.faces)
