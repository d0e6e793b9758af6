"""The jig: its parts are closed bodies that hold sheet, lens and eye where the design has them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection, Manifold, Mesh, OpType

from magiclens.contract.artifacts import Lens, Scene, Solid, View
from magiclens.contract.errors import InputError
from magiclens.exporting.jig import Jig
from magiclens.exporting.jig_parts import JigPart, JigShape, jig_parts, sight
from magiclens.geometry.solid import solid_from_heights
from scenes import surface

LENS = Lens(size_mm=60.0, source_size_mm=60.0, facets=2, microfacets=1, thickness_mm=8.0)
MARKED = replace(LENS, facets=6, microfacets=10, mark=True)
SHAPE = JigShape(0.2, 0.15, 3.0, 220.0, True)
EYE = (0.0, 0.0, 408.0)


def scene_of(lens: Lens = LENS, *eyes: tuple[float, float, float], turns: tuple[float, ...] = (0.0,)) -> Scene:
    picture = np.ones((8, 8, 1), np.float32)
    places = [(np.array(eye), turn) for eye in eyes or (EYE,) for turn in turns]
    return Scene(lens, tuple(View(f"v{k}", picture, picture, *place) for k, place in enumerate(places)))


def slab(lens: Lens = LENS, eye: tuple[float, float, float] | None = EYE) -> Solid:
    return solid_from_heights(surface(lens, np.zeros(1), eye))


def block(half: float, low: float, high: float) -> Manifold:
    return Manifold.cube([2 * half, 2 * half, high - low]).translate([-half, -half, low])


def bottom_half(solid: Solid) -> float:
    return float(solid.vertices[solid.vertices[:, 2] == 0][:, 0].max())


def volume_of_overlap(one: Manifold, parts: list[JigPart]) -> float:
    return sum((one ^ part.body).volume() for part in parts)


@pytest.mark.parametrize("source", [60.0, 80.0])
def test_sheet_and_lens_fit_and_are_held(source: float) -> None:
    """Both have room where they belong, and none a millimetre aside."""
    lens = replace(LENS, source_size_mm=source)
    solid = slab(lens)
    parts = jig_parts(scene_of(lens), solid, SHAPE)
    half = bottom_half(solid)
    sheet, foot = block(source / 2, -0.15, 0.0), block(half, 0.0, 7.0)
    for body in (sheet, foot):
        assert volume_of_overlap(body, parts) < 1e-6
        for way in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]):
            assert volume_of_overlap(body.translate(way), parts) > 1.0
    assert ("inset" in [part.name for part in parts]) == (source == 80.0)


ABOVE_BELOW = [(0.0, 107.0, 408.0), (0.0, -107.0, 408.0)]
RIGHT_TOO = [*ABOVE_BELOW, (107.0, 0.0, 408.0)]


@pytest.mark.parametrize(
    "eyes", [[EYE], ABOVE_BELOW[:1], ABOVE_BELOW, RIGHT_TOO], ids=["centre", "above", "two", "three"]
)
def test_every_eye_looks_through_a_peephole_and_nothing_is_in_its_way(eyes: list[tuple[float, float, float]]) -> None:
    parts = jig_parts(scene_of(LENS, *eyes), slab(), SHAPE)
    standing = [part.body for part in parts if not part.name.startswith("arm")]
    assert len(standing[0].decompose()) == 1, "the column's block is joined to the tray, on whichever side"
    for x, y, z in eyes:
        arm = "arm" if len(eyes) == 1 else f"arm-{sorted(eyes, key=lambda eye: eye[1]).index((x, y, z)) + 1}"
        whole = Manifold.batch_boolean([*standing, *(part.body for part in parts if part.name == arm)], OpType.Add)
        assert (sight(LENS, (x, y, z)) ^ whole).volume() < 1e-6
        hole = Manifold.cylinder(4.0, 1.4).translate([x, y, z])
        assert (hole ^ whole).volume() < 1e-6
        ring = Manifold.cylinder(4.0, 6.0).translate([x + 8, y, z]) ^ whole
        assert ring.volume() > 100, "the peephole is in a plate"


def test_parts_fit_a_bed_and_are_closed_in_their_files(tmp_path: Path) -> None:
    lens = replace(MARKED, size_mm=200.0, source_size_mm=200.0)
    exporter = Jig(bed="150mm")
    exporter.export(scene_of(lens, turns=(0.0, 90.0)), slab(lens), tmp_path / "lens.jig.stl")
    files = sorted(path.name for path in tmp_path.iterdir())
    assert {"lens.jig.stl", "lens.jig-tray-4.stl", "lens.jig-arm.stl", "lens.jig-column-part-3.stl"} <= set(files)
    for name in files:
        mesh = trimesh.load_mesh(tmp_path / name)
        assert mesh.is_watertight, name
        assert mesh.volume > 0, name
        assert mesh.body_count == 1, name
        assert mesh.extents.max() <= 150 + 1e-3, name
        assert mesh.bounds[0, 2] == pytest.approx(0, abs=1e-4), name
        assert mesh.bounds[:, :2].sum(axis=0) == pytest.approx([0, 0], abs=1e-3), name


def area_at(body: Manifold, z: float) -> float:
    return float(body.slice(z).area())


def test_an_arrow_in_the_wall_points_up_the_sheet() -> None:
    tray = next(part.body for part in jig_parts(scene_of(), slab(), replace(SHAPE, stand=False)) if part.name == "tray")
    arrow = tray.slice(6.5) - tray.slice(7.5)
    left, low, right, high = arrow.bounds()
    assert 10 < arrow.area() < 40
    assert (left + right) / 2 == pytest.approx(0, abs=1e-3)
    assert bottom_half(slab()) < low < high < tray.bounding_box()[4]
    upper = arrow.area() - (arrow ^ CrossSection.square([40, low + high], True)).area()
    assert upper < arrow.area() / 3, "its tip is up"
    assert area_at(tray, 7.99) == pytest.approx(area_at(tray, 7.5)), "it is open to the top"


def test_the_arrow_is_in_the_middle_of_a_tray_for_an_eye_aside() -> None:
    eye = (200.0, 0.0, 408.0)  # the slab's bottom reaches further left than right
    lens = replace(LENS, source_size_mm=50.0)
    tray = jig_parts(scene_of(lens, eye), slab(lens, eye), replace(SHAPE, stand=False))[0].body
    left, _, right, _ = (tray.slice(6.5) - tray.slice(7.5)).bounds()
    box = tray.bounding_box()
    assert box[0] + box[3] < -3
    assert (left + right) / 2 == pytest.approx((box[0] + box[3]) / 2, abs=1e-3)


@pytest.mark.parametrize("eye", [(0.0, 200.0, 408.0), (200.0, 0.0, 408.0)], ids=["above", "aside"])
def test_a_lens_in_the_air_needs_a_ledge_on_two_opposite_sides_only(eye: tuple[float, float, float]) -> None:
    lens = replace(LENS, source_size_mm=52.0, gap_mm=5.0)
    vertices = slab(lens, eye).vertices
    bottom = vertices[vertices[:, 2] == 0, :2]
    reach = np.array([-bottom.min(axis=0), bottom.max(axis=0)]) - 26.2  # what is left beside the pocket
    assert sorted(reach.min(axis=0) > 1.0) == [False, True]
    jig_parts(scene_of(lens, eye), slab(lens, eye), replace(SHAPE, stand=False))
    wide = replace(lens, source_size_mm=64.0)
    with pytest.raises(InputError, match="nothing would hold the lens 5 mm above"):
        jig_parts(scene_of(wide, eye), slab(wide, eye), replace(SHAPE, stand=False))


def test_parts_stand_on_their_flat_ends_and_the_sheet_lies_on_a_floor() -> None:
    parts = {part.name: part for part in jig_parts(scene_of(), slab(), SHAPE)}
    tray = parts["tray"].on_bed()
    assert area_at(tray, 1.0) > 60**2, "the floor has no hole"
    pocket = area_at(tray, 1.0) - area_at(tray, 2.1)
    assert pocket == pytest.approx(60.4**2, rel=1e-4), "and above it there is room for the sheet"
    for name in ("column-part-1", "arm"):
        body = parts[name].on_bed()
        top = body.bounding_box()[5]
        assert area_at(body, top - 0.1) == pytest.approx(12.0**2, rel=1e-4), "a peg stands up"
        assert area_at(body, 0.1) > 100
    eye = parts["arm"].body.bounding_box()
    assert (eye[2], eye[5]) == pytest.approx((408 - 14, 408 + 5), abs=1e-3), "the arm's underside is where the eye is"


def test_columns_go_from_the_block_to_the_eye_in_equal_parts() -> None:
    parts = jig_parts(scene_of(), slab(), replace(SHAPE, bed=150.0))
    boxes = [part.body.bounding_box() for part in parts if part.name.startswith("column")]
    tops = [box[5] for box in boxes]
    assert tops == pytest.approx([20 + (408 - 20) * k / 3 for k in (1, 2, 3)], abs=1e-3)
    assert [box[5] - box[2] for box in boxes] == pytest.approx([388 / 3 + 14] * 3, abs=1e-3)


def test_tiles_are_equal_and_together_the_tray() -> None:
    lens = replace(LENS, size_mm=200.0, source_size_mm=200.0)
    one, four = (
        [part.body for part in jig_parts(scene_of(lens), slab(lens), replace(SHAPE, stand=False, bed=bed))]
        for bed in (400.0, 150.0)
    )
    assert (len(one), len(four)) == (1, 4)
    assert sum(body.volume() for body in four) == pytest.approx(one[0].volume())
    sides = np.array([body.bounding_box() for body in four])
    assert np.ptp(sides[:, 3] - sides[:, 0]) < 1e-3
    assert np.ptp(sides[:, 4] - sides[:, 1]) < 1e-3
    whole = Manifold.batch_boolean(four, OpType.Add).bounding_box()
    assert whole == pytest.approx(one[0].bounding_box(), abs=1e-3)


def test_a_bed_just_large_enough_is_large_enough() -> None:
    body = next(part for part in jig_parts(scene_of(), slab(), SHAPE) if part.name == "arm").on_bed()
    low, high = np.split(np.array(body.bounding_box()), 2)
    longest = float((high - low).max())
    jig_parts(scene_of(), slab(), replace(SHAPE, bed=longest))
    with pytest.raises(InputError, match="exporter jig: bed"):
        jig_parts(scene_of(), slab(), replace(SHAPE, bed=longest - 0.01))


def test_pieces_go_into_each_other_with_the_clearance() -> None:
    parts = {part.name: part.body for part in jig_parts(scene_of(), slab(), replace(SHAPE, bed=150.0))}
    assert [name for name in parts if name.startswith("column")] == [f"column-part-{k}" for k in (1, 2, 3)]
    chain = [parts["tray"], *(parts[f"column-part-{k}"] for k in (1, 2, 3)), parts["arm"]]
    for lower, upper in pairwise(chain):
        assert (lower ^ upper).volume() < 1e-6
        assert (lower ^ upper.translate([0.5, 0, 0])).volume() > 1.0, "the peg is held"


def test_a_marked_lens_fits_only_as_it_belongs() -> None:
    solid = slab(MARKED)
    marked = Manifold(Mesh(solid.vertices.astype(np.float32), solid.faces.astype(np.uint32)))
    parts = jig_parts(scene_of(MARKED), solid, SHAPE)
    assert volume_of_overlap(marked, parts) < 1e-6
    for turn in (90, 180, 270):
        assert volume_of_overlap(marked.rotate([0, 0, turn]), parts) > 0.5
    turned = jig_parts(scene_of(MARKED, turns=(0.0, 90.0)), solid, SHAPE)
    assert volume_of_overlap(marked.rotate([0, 0, 90]), turned) < 1e-6
    assert volume_of_overlap(marked.rotate([0, 0, 180]), turned) > 0.5
    assert slab(replace(MARKED, mark=False)).vertices[:, 1].max() < marked.bounding_box()[4] - 1.1


def test_equal_lenses_get_equal_bytes(tmp_path: Path) -> None:
    contents: list[dict[str, bytes]] = []
    for k in range(2):
        (tmp_path / str(k)).mkdir()
        Jig().export(scene_of(), slab(), tmp_path / str(k) / "lens.jig.stl")
        contents.append({path.name: path.read_bytes() for path in (tmp_path / str(k)).iterdir()})
    assert contents[0] == contents[1]
    names = {"lens.jig.stl", "lens.jig-column-part-1.stl", "lens.jig-column-part-2.stl", "lens.jig-arm.stl"}
    assert set(contents[0]) == names


def test_without_a_stand_there_is_only_the_tray(tmp_path: Path) -> None:
    Jig(stand=False).export(scene_of(), slab(), tmp_path / "lens.jig.stl")
    assert [path.name for path in tmp_path.iterdir()] == ["lens.jig.stl"]


@pytest.mark.parametrize(
    ("lens", "bed", "words"),
    [
        (replace(LENS, gap_mm=100.0), 220.0, "the sheet would lie 100 mm deep"),
        (replace(LENS, gap_mm=2.0), 220.0, "nothing would hold the lens 2 mm above"),
        (replace(LENS, source_size_mm=63.0), 220.0, "too little for a frame"),
        (LENS, 80.0, "use a bed of 2"),
    ],
)
def test_what_no_jig_can_hold_is_said(lens: Lens, bed: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        jig_parts(scene_of(lens, (0.0, 150.0, 408.0)), slab(lens, None), replace(SHAPE, bed=bed))


def test_a_frame_must_be_wide_enough_on_every_side() -> None:
    """Under an eye aside the lens's bottom lies off the sheet's middle: on one side a frame would be a millimetre."""
    eye, lens = (0.0, 150.0, 408.0), replace(LENS, source_size_mm=69.0)
    with pytest.raises(InputError, match=r"reaches 0\.\d* to 6\.\d* mm beyond .* too little for a frame"):
        jig_parts(scene_of(lens, eye), slab(lens, eye), replace(SHAPE, stand=False))
