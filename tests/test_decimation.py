"""Fewer triangles: within the bound everywhere, closed, and exact where facets meet.

Tools tier: its kernel takes 10 s to compile, and is no other file's.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabricated import LENS, bumpy, flat, written
from lenses import SPECS, Lenses
from magiclens import run_spec
from magiclens.contract.artifacts import FloatArray, IntArray, Solid
from magiclens.exporting.gltf import Glb
from magiclens.exporting.mesh_files import MeshExporter, Obj, Ply, Stl
from magiclens.exporting.three_mf import ThreeMf
from magiclens.geometry.decimation import decimated
from magiclens.geometry.solid import grid_lines, volume
from magiclens.images import score
from magiclens.meshing.validation import check_areas, check_topology
from magiclens.preflight.mesh_file import read_mesh_file
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.running.open_run import open_run
from magiclens.testing.scenes import bumpy_solid, one_view

SCENE = one_view()


def seen_at(solid: Solid) -> FloatArray:
    """(V, 2): where vertices are seen on the reference plane."""
    eye, thickness = SCENE.reference_eye_mm, SCENE.lens.thickness_mm
    stretch = (eye[2] - thickness) / (eye[2] - solid.vertices[:, 2:])
    return np.asarray(eye[:2] + (solid.vertices[:, :2] - eye[:2]) * stretch)


def triangles_at(solid: Solid, points: FloatArray) -> IntArray:
    """(P,) the triangle of the top that is seen at each point (P, 2) of the reference plane."""
    top = np.flatnonzero((solid.vertices[solid.faces, 2] > 0).all(axis=1))
    corners = seen_at(solid)[solid.faces[top]] - points[:, None, None]
    x, y = np.moveaxis(corners, -1, 0)
    turns = x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1)
    return np.asarray(top[(turns.min(axis=-1) >= 0).argmax(axis=1)])


def normals_of(solid: Solid, faces: IntArray) -> FloatArray:
    a, b, c = np.moveaxis(solid.vertices[solid.faces[faces]], 1, 0)
    across = np.cross(b - a, c - a)
    return np.asarray(across / np.linalg.norm(across, axis=-1, keepdims=True))


@pytest.mark.parametrize("tolerance_deg", [0.3, 3.0])
@pytest.mark.tools
def test_no_normal_turns_by_more_than_the_tolerance(tolerance_deg: float) -> None:
    whole = bumpy_solid(SCENE)
    fewer = decimated(whole, SCENE.lens, tolerance_deg)
    assert len(fewer.faces) < len(whole.faces)
    half = SCENE.lens.size_mm / 2 - 0.01
    points = np.random.default_rng(1).uniform(-half, half, (3000, 2))
    lines = (np.arange(1, SCENE.lens.facets) - SCENE.lens.facets / 2) * SCENE.lens.pitch_mm
    points = points[(abs(points[..., None] - lines) > SCENE.lens.wall_mm).all(axis=(1, 2))]
    old, new = (triangles_at(solid, points) for solid in (whole, fewer))
    cosines = (normals_of(whole, old) * normals_of(fewer, new)).sum(axis=-1)
    turned_deg = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    assert turned_deg.max() <= tolerance_deg * 1.0001
    assert turned_deg.max() > tolerance_deg / 3, "the bound is made use of"


@pytest.mark.parametrize("tolerance_deg", [0.3, 3.0])
@pytest.mark.tools
def test_vertices_that_are_left_out_are_near_the_surface(tolerance_deg: float) -> None:
    whole, lens = bumpy_solid(SCENE), SCENE.lens
    fewer = decimated(whole, lens, tolerance_deg)
    inside = np.flatnonzero((abs(seen_at(whole)) < lens.size_mm / 2 - 0.01).all(axis=-1) & (whole.vertices[:, 2] > 0))
    above = triangles_at(fewer, seen_at(whole)[inside])
    off = (whole.vertices[inside] - fewer.vertices[fewer.faces[above, 0]]) * normals_of(fewer, above)
    assert abs(off.sum(axis=-1)).max() <= np.radians(tolerance_deg) * lens.pitch_mm / lens.microfacets


@pytest.mark.parametrize("eye", [(0.0, 0.0, 108.0), None])
@pytest.mark.tools
def test_borders_walls_rim_and_floor_stay(eye: tuple[float, float, float] | None) -> None:
    whole = bumpy(eye)
    fewer = decimated(whole, LENS, 3.0)
    lines = len(grid_lines(LENS))
    line = np.arange(lines) - 1
    inner = (line % (LENS.microfacets + 1) > 0) & (line % (LENS.microfacets + 1) < LENS.microfacets) & (line >= 0)
    may_go = np.append((inner[:, None] & inner).ravel(), np.zeros(len(whole.vertices) - lines**2, bool))
    places = {point.tobytes() for point in fewer.vertices}
    assert all(point.tobytes() in places for point in whole.vertices[~may_go])
    kept = {solid_faces.tobytes() for solid_faces in whole.vertices[whole.faces[~may_go[whole.faces].any(axis=1)]]}
    assert len(kept - {found.tobytes() for found in fewer.vertices[fewer.faces]}) <= 4 * LENS.facets**2, "but corners"


@pytest.mark.tools
def test_it_is_closed_and_holds_the_same_volume() -> None:
    whole = bumpy_solid(SCENE)
    fewer = decimated(whole, SCENE.lens, 2.0)
    assert not (check_topology(fewer) + check_areas(fewer)).flaws
    assert volume(fewer) == pytest.approx(volume(whole), rel=1e-4)


@pytest.mark.tools
def test_of_flat_facets_only_the_borders_are_left() -> None:
    lens = replace(LENS, microfacets=8)
    whole = flat(lens, (0.0, 0.0, 108.0))
    fewer = decimated(whole, lens, 0.01)
    gone = len(whole.faces) - len(fewer.faces)
    # n points on the border of a polygon make n - 2 triangles
    assert gone == lens.facets**2 * (2 * 8**2 - (4 * 8 - 2))


@pytest.mark.tools
def test_without_a_tolerance_or_a_grid_the_mesh_is_whole() -> None:
    whole = bumpy_solid(SCENE)
    assert decimated(whole, SCENE.lens, 0.0) is whole
    without = replace(whole, grid=None)
    assert decimated(without, SCENE.lens, 1.0) is without


@pytest.mark.parametrize("exporter", [Stl, Ply, Obj, ThreeMf, Glb])
@pytest.mark.tools
def test_every_mesh_file_may_be_decimated(exporter: type[MeshExporter], tmp_path: Path) -> None:
    solid = bumpy_solid(SCENE)
    fewer, again, whole = (
        written(exporter(tolerance=tolerance), tmp_path / name, solid, SCENE)
        for name, tolerance in (("fewer", "30mrad"), ("again", "30mrad"), ("whole", "0deg"))
    )
    assert fewer.read_bytes() == again.read_bytes()
    assert whole.read_bytes() == written(exporter(), tmp_path / "usual", solid, SCENE).read_bytes()
    wanted = len(decimated(solid, SCENE.lens, np.degrees(0.03)).faces)
    assert len(read_mesh_file(fewer).triangles) == wanted < len(solid.faces)


@pytest.mark.tools
def test_preflight_sees_the_picture_through_a_decimated_file(lenses: Lenses) -> None:
    fewer, whole = (
        lenses.shipped("single", f"pipeline.exporters=[{{type: 3mf, tolerance: {tolerance}}}]")
        for tolerance in ("40mrad", "0deg")
    )
    assert (fewer.folder / "lens.3mf").stat().st_size < 0.9 * (whole.folder / "lens.3mf").stat().st_size
    of_fewer, of_whole = (
        {check["check"]: check["status"] for check in json.loads((run.folder / "preflight.json").read_text())["checks"]}
        for run in (fewer, whole)
    )
    assert of_fewer == of_whole
    assert of_fewer["mirror image"] == "green"


@pytest.mark.sweep
def test_the_file_for_slicers_of_four_rotations_is_small_and_shows_the_same(tmp_path: Path) -> None:
    run_spec(SPECS / "rotating.yaml", tmp_path / "run", ["report.analyses=[]", "pipeline.renderers=[]"])
    file = tmp_path / "run" / "lens.3mf"
    assert file.stat().st_size < 20e6
    run = open_run(tmp_path / "run")
    scene = run.printed_scene
    was, now = (Mitsuba().render(scene, solid) for solid in (run.solid, read_mesh_file(file).solid(scene.cut_eye_mm)))
    for view, before, after in zip(scene.views, was, now, strict=True):
        assert score(before, view.target).psnr_db - score(after, view.target).psnr_db <= 0.2, view.name
