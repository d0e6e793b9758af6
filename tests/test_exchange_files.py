"""3MF, glTF and height maps say the same as the solid, in their own units and frames."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from PIL import Image

from fabricated import EYE, LENS, box, bumpy, flat, written
from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Exporter
from magiclens.exporting.digits import numbers_of, text_rows
from magiclens.exporting.gltf import Glb
from magiclens.exporting.height_map import HeightMap
from magiclens.exporting.mesh_files import Stl
from magiclens.exporting.three_mf import ThreeMf
from magiclens.geometry.columns import top_heights

MICROMETRE = 1e-3
EXPORTERS = [ThreeMf(), Glb(), HeightMap()]


def read_3mf(path: Path) -> Any:
    """The model that lib3mf reads, strictly."""
    import lib3mf

    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(path))
    assert reader.GetWarningCount() == 0
    return model


def mesh_of(model: Any) -> Any:
    """The only mesh of a model."""
    meshes = model.GetMeshObjects()
    assert meshes.Count() == 1
    assert meshes.MoveNext()
    return meshes.GetCurrentMeshObject()


def vertices_3mf(path: Path) -> FloatArray:
    """(V, 3) mm, where the build item puts them, moved back by the same transform."""
    mesh = mesh_of(read_3mf(path))
    return np.array([list(v.Coordinates) for v in mesh.GetVertices()])


def vertices_glb(path: Path) -> FloatArray:
    """(V, 3) mm in the lens frame, from what trimesh reads in metres with +y up."""
    import trimesh

    scene = trimesh.load_scene(path, process=False)
    assert scene.units == "meters"
    x, up, back = np.asarray(scene.to_mesh().vertices).T * 1000
    return np.stack([x, -back, up], axis=-1)


def vertices_stl(path: Path) -> FloatArray:
    """(3 F, 3) mm."""
    import trimesh

    return np.asarray(trimesh.load_mesh(path, process=False).vertices)


def bounds(vertices: FloatArray) -> FloatArray:
    """(2, 3): lowest and highest corner."""
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def heights_in(path: Path) -> tuple[FloatArray, dict[str, Any]]:
    """(rows, columns) mm, and what the file beside the picture says."""
    facts = json.loads(path.with_suffix(".json").read_text())
    image = Image.open(path)
    assert image.mode.startswith("I;16")
    low, high = facts["z_at_0_mm"], facts["z_at_65535_mm"]
    return low + np.asarray(image) / 65535 * (high - low), facts


def test_all_files_agree_on_the_size_within_a_micrometre(tmp_path: Path) -> None:
    solid = bumpy()
    expected = bounds(solid.vertices)
    readers = {Stl(): vertices_stl, ThreeMf(): vertices_3mf, Glb(): vertices_glb}
    for exporter, read in readers.items():
        assert np.abs(bounds(read(written(exporter, tmp_path, solid))) - expected).max() < MICROMETRE
    heights, facts = heights_in(written(HeightMap(pixel="0.02mm"), tmp_path, solid))
    assert facts["size_mm"] == [LENS.size_mm, LENS.size_mm]
    assert facts["pixel_mm"] * heights.shape[1] == pytest.approx(LENS.size_mm, abs=MICROMETRE)
    corners = vertices_stl(tmp_path / "lens.stl")
    read_back = Solid(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    x = (np.arange(500) + 0.5) * facts["pixel_mm"] - LENS.size_mm / 2
    assert np.abs(heights - top_heights(read_back, x, -x)).max() < MICROMETRE


def test_3mf_holds_the_mesh_in_millimetres(tmp_path: Path) -> None:
    import lib3mf

    solid = bumpy()
    model = read_3mf(written(ThreeMf(), tmp_path, solid))
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    mesh = mesh_of(model)
    assert mesh.IsManifoldAndOriented()
    faces = np.array([list(t.Indices) for t in mesh.GetTriangleIndices()])
    assert np.array_equal(faces, solid.faces)
    places = np.array([list(v.Coordinates) for v in mesh.GetVertices()])
    assert np.abs(places - solid.vertices).max() < 1.5e-6  # a nanometre of text, and lib3mf's float32


def test_3mf_has_one_item_in_the_positive_octant_and_says_what_it_is(tmp_path: Path) -> None:
    solid = bumpy()
    model = read_3mf(written(ThreeMf(), tmp_path, solid))
    items = model.GetBuildItems()
    assert items.Count() == 1
    items.MoveNext()
    moved = np.array([list(column) for column in items.GetCurrent().GetObjectTransform().Fields])
    assert np.array_equal(moved[:3], np.eye(3))
    assert (solid.vertices + moved[3]).min(axis=0) == pytest.approx([0, 0, 0], abs=1e-5)
    group = model.GetMetaDataGroup()
    found = {group.GetMetaData(k).GetName(): group.GetMetaData(k).GetValue() for k in range(group.GetMetaDataCount())}
    assert found == {
        "Title": "Magic lens, 10 x 10 mm, index of refraction 1.49",
        "Designer": "magiclens",
        "Application": "magiclens",
    }


def test_a_broken_3mf_is_noticed(tmp_path: Path) -> None:
    """The reader above is strict enough to see what could go wrong."""
    import lib3mf

    solid = bumpy()
    wrong = Solid(solid.vertices, solid.faces + np.int32(1))
    with pytest.raises(lib3mf.ELib3MFException):
        read_3mf(written(ThreeMf(), tmp_path, wrong))
    holed = Solid(solid.vertices, solid.faces[1:])
    assert not mesh_of(read_3mf(written(ThreeMf(), tmp_path, holed))).IsManifoldAndOriented()


def test_3mf_is_whole_where_it_is_written_in_many_pieces(tmp_path: Path) -> None:
    """Of more vertices and faces than are turned to text at one time."""
    lens = Lens(size_mm=10.0, facets=9, microfacets=31, thickness_mm=8.0)
    solid = bumpy(lens=lens)
    assert len(solid.vertices) > 1 << 16
    package = ZipFile(written(ThreeMf(), tmp_path, solid))
    assert {info.date_time for info in package.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    model = package.read("3D/3dmodel.model").decode()
    vertices = re.findall(r'<vertex x="([-.\d]+)" y="([-.\d]+)" z="([-.\d]+)"/>', model)
    assert np.abs(np.array(vertices, float) - solid.vertices).max() < 1e-6
    faces = re.findall(r'<triangle v1="(\d+)" v2="(\d+)" v3="(\d+)"/>', model)
    assert np.array_equal(np.array(faces, int), solid.faces)


def test_numbers_as_text_have_their_decimals_without_zeros_at_the_end() -> None:
    numbers = np.array([[0, 1], [-1, 1500000], [-12345678, 10**12], [-(10**18), 999999]])
    fixed = text_rows(numbers, (b"(", b",", b");"), 6)
    assert fixed == b"(0,0.000001);(-0.000001,1.5);(-12.345678,1000000);(-1000000000000,0.999999);"
    whole = text_rows(numbers[:3], (b"(", b",", b");"))
    assert whole == b"(0,1);(-1,1500000);(-12345678,1000000000000);"


def test_numbers_are_read_as_python_reads_them() -> None:
    around = (b"<", b" ", b">\n")
    numbers = np.random.default_rng(3).integers(-(10**9), 10**9, (500, 2))
    text = text_rows(numbers, around, 6)
    read = [[float(number) for number in line[1:-1].split()] for line in text.splitlines()]
    np.testing.assert_array_equal(numbers_of(text, around), read)


@pytest.mark.parametrize(
    "text", [b"<1 2>", b"<1 2>\n ", b"<1 >\n", b"<1e3 2>\n", b"<1 2>\n<1  2>\n", b"<1 .>\n", b"<1\n"]
)
def test_text_of_another_form_is_left_to_other_readers(text: bytes) -> None:
    assert numbers_of(text, (b"<", b" ", b">\n")) is None


def test_glb_is_in_metres_with_the_viewer_above(tmp_path: Path) -> None:
    solid = box((1, 2, 0), (4, 7, 9))
    path = written(Glb(), tmp_path, solid)
    import trimesh

    mesh = trimesh.load_scene(path, process=False).to_mesh()
    assert mesh.bounds.ravel() == pytest.approx([0.001, 0, -0.007, 0.004, 0.009, -0.002])
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(3 * 5 * 9 * 1e-9)


def test_glb_holds_every_triangle_in_its_place_and_order(tmp_path: Path) -> None:
    solid = bumpy()
    path = written(Glb(), tmp_path, solid)
    assert np.abs(vertices_glb(path) - solid.vertices).max() < 1e-6
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    asset = json.loads(data[20 : 20 + size])
    body = data[28 + size :]
    assert len(body) == asset["buffers"][0]["byteLength"] == 12 * (len(solid.vertices) + len(solid.faces))
    faces = np.frombuffer(body[asset["bufferViews"][1]["byteOffset"] :], "<u4").reshape(-1, 3)
    assert np.array_equal(faces, solid.faces)
    points = np.frombuffer(body[: asset["bufferViews"][0]["byteLength"]], "<f4").reshape(-1, 3)
    assert asset["accessors"][0]["min"] == points.min(axis=0).tolist()
    assert asset["accessors"][0]["max"] == points.max(axis=0).tolist()


def test_glb_is_clear_plastic(tmp_path: Path) -> None:
    lens = Lens(size_mm=10, facets=3, microfacets=4, thickness_mm=8, ior=1.57)
    data = written(Glb(), tmp_path, flat(lens), Scene(lens, ())).read_bytes()
    asset = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    glass = asset["materials"][0]["extensions"]
    assert glass["KHR_materials_ior"] == {"ior": 1.57}
    assert glass["KHR_materials_volume"] == {"thicknessFactor": 0.008}
    assert sorted(asset["extensionsUsed"]) == sorted(glass)


def test_height_map_is_white_where_the_top_is_highest(tmp_path: Path) -> None:
    """A ramp that rises to the right, higher in the upper half."""
    solid = box((-5, -5, 0), (5, 5, 2))
    vertices = solid.vertices + (solid.vertices[:, :1] + 5) * (solid.vertices[:, 2:] > 0) * [0, 0, 0.1]
    heights, facts = heights_in(written(HeightMap(pixel="0.5mm"), tmp_path, Solid(vertices, solid.faces)))
    assert heights.shape == (20, 20)
    assert np.abs(heights - (2 + (np.arange(20) * 0.5 + 0.25) * 0.1)).max() < 2e-5
    assert (facts["z_at_0_mm"], facts["z_at_65535_mm"]) == pytest.approx((2.025, 2.975))
    grey = np.asarray(Image.open(tmp_path / "lens.heightmap.png"))
    assert (grey[:, 0] == 0).all()
    assert (grey[:, -1] == 65535).all()


def test_height_map_of_a_leaning_top_is_its_highest_point(tmp_path: Path) -> None:
    solid = bumpy((60.0, 0.0, 60.0))
    heights, facts = heights_in(written(HeightMap(pixel="0.1mm"), tmp_path, solid))
    x = (np.arange(100) + 0.5) * 0.1 - 5
    z = np.nan_to_num(top_heights(solid, x, -x), nan=facts["z_at_0_mm"])
    assert np.abs(heights - z).max() < facts["z_at_65535_mm"] / 65535


def test_height_map_of_a_flat_top_is_white_and_knows_its_height(tmp_path: Path) -> None:
    heights, facts = heights_in(written(HeightMap(pixel="0.3mm"), tmp_path, flat()))
    assert heights == pytest.approx(np.full((33, 33), LENS.thickness_mm))
    assert (facts["thickness_mm"], facts["z_at_65535_mm"]) == (LENS.thickness_mm, LENS.thickness_mm)
    assert facts["pixel_mm"] == pytest.approx(10 / 33)


@pytest.mark.parametrize(("pixel", "near"), [("8mm", "5mm"), ("0.1um", "0.0007mm")])
def test_height_map_of_too_many_or_too_few_pixels_is_refused(pixel: str, near: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"pixels; .* per side are possible, the nearest is '{near}'"):
        written(HeightMap(pixel=pixel), tmp_path, flat())
    side = LENS.size_mm / HeightMap(pixel=near).pixel
    assert 2 <= round(side) <= 16384


@pytest.mark.parametrize("exporter", EXPORTERS, ids=[e.type for e in EXPORTERS])
def test_equal_solids_give_equal_bytes_and_others_do_not(exporter: Exporter, tmp_path: Path) -> None:
    solids = {"one": bumpy(), "same": bumpy(), "other": bumpy(EYE, seed=6)}
    one, same, other = (written(exporter, tmp_path / name, solid).read_bytes() for name, solid in solids.items())
    assert one == same
    assert one != other
