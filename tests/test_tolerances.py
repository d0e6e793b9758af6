"""Tolerances: what pictures lose when sheet, lens, eye, gap or material are not as designed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lenses import Lenses
from magiclens.analysis import tolerances as analysis
from magiclens.analysis.tolerances import TOLERANCES, Response
from magiclens.contract.artifacts import FloatArray, Scene, Solid, View
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import score
from magiclens.preflight.placing import check_placing
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.poses import Pose, PosedLens
from magiclens.rendering.tracer import Tracer
from scenes import ABOVE, THICK, Eye, blotches, grey_view, small_lens, surface


def slab(eye: Eye = ABOVE, turn: float = 0.0) -> tuple[Scene, Solid]:
    """A flat slab over blotches, which shows them unchanged."""
    lens = small_lens(facets=4, pitch=5.0, source=40.0)
    view = grey_view(blotches(400, 12.0), np.zeros((40, 40), np.float32), eye, turn)
    return Scene(lens, (view,)), solid_from_heights(surface(lens, np.zeros(1)))


def seen(scene: Scene, solid: Solid, pose: Pose, resolution: int = 64) -> FloatArray:
    return PosedLens(solid, scene.lens, resolution, 2).picture(scene.views[0], pose)


@pytest.mark.parametrize("turn", [0.0, 90.0, 270.0])
def test_as_designed_it_is_the_picture_of_the_tracer(turn: float) -> None:
    scene, solid = slab((30.0, -10.0, 440.0), turn)
    [rendered] = Tracer(resolution=64, samples=2).render(scene, solid)
    np.testing.assert_allclose(seen(scene, solid, Pose()), rendered, atol=1e-5)


@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_a_sheet_that_is_moved_turned_and_enlarged_is_another_sheet(turn: float) -> None:
    """The same picture is seen of a source that is drawn in this way."""
    scene, solid = slab(turn=turn)
    pose = Pose(shift_x_mm=1.3, shift_y_mm=-0.7, rotation_deg=9.0, scale_percent=4.0)
    at = (np.arange(400) + 0.5) / 10 - 20
    x, y = at[None, :] - 1.3, -at[:, None] + 0.7
    c, s = np.cos(np.radians(9)) / 1.04, np.sin(np.radians(9)) / 1.04
    places = np.stack([c * x + s * y, c * y - s * x])
    [view] = scene.views
    drawn = map_coordinates(view.source[..., 0], [(20 - places[1]) * 10 - 0.5, (places[0] + 20) * 10 - 0.5], order=1)
    moved = replace(scene, views=(replace(view, source=drawn[..., None].astype(np.float32)),))
    np.testing.assert_allclose(seen(scene, solid, pose), seen(moved, solid, Pose()), atol=2e-3)


@pytest.mark.parametrize("turn", [0.0, 90.0, 180.0])
def test_a_lens_that_leans_is_a_tilted_slab(turn: float) -> None:
    """The ray through the middle of a flat slab, by Snell's law in the plane of the tilt: upper edge lifted."""
    scene, solid = slab(turn=turn)
    tilt, half, (_, _, eye) = np.radians(3.0), 10.0, ABOVE
    lift = half * np.sin(tilt)
    top = np.array([-THICK * np.sin(tilt), THICK * np.cos(tilt) + lift])  # y and z of the middle of the top
    way = top - [0.0, eye]
    normal = np.array([-np.sin(tilt), np.cos(tilt)])
    along, across = -normal, np.array([normal[1], -normal[0]])
    inside = np.arcsin(way @ across / np.linalg.norm(way) / scene.lens.ior)
    # below the slab, the ray goes on in its first direction
    bottom = top + THICK * along + THICK * np.tan(inside) * across
    landing = bottom[0] - way[0] / way[1] * bottom[1]
    posed = PosedLens(solid, scene.lens, 63, 1)
    hits = posed.landing(scene.views[0], Pose(tilt_x_deg=3.0))
    assert hits[31, 31, 0, :2] == pytest.approx([0.0, landing], abs=2e-3)


def test_gap_eye_and_index_are_those_of_another_design() -> None:
    scene, solid = slab()
    [view] = scene.views
    lens = replace(scene.lens, gap_mm=2.0, ior=1.52)
    other = Scene(lens, (replace(view, eye_mm=np.array([5.0, -3.0, 430.0])),))
    pose = Pose(gap_mm=2.0, ior=0.03, eye_x_mm=5.0, eye_y_mm=-3.0, eye_z_mm=-10.0)
    np.testing.assert_allclose(seen(scene, solid, pose), seen(other, solid, Pose()), atol=1e-5)


def test_limits_are_where_the_first_view_has_lost_three_decibels() -> None:
    amounts = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    error = 1e-3 * (1 + amounts**2)  # doubled at 1
    psnr = np.stack([-10 * np.log10(error), -10 * np.log10(1e-3 * (1 + (amounts * (amounts > 0)) ** 2 / 2))])
    response = Response("shift_x_mm", "mm", amounts, psnr, psnr)
    assert response.limit(1) == pytest.approx(1.0, abs=0.01) == response.limit(-1)
    flat = replace(response, psnr_db=psnr[1:])
    assert flat.limit(1) == pytest.approx(np.sqrt(2), abs=0.01)
    assert flat.limit(-1) == 2.0, "it loses nothing there"
    assert flat.tolerance == flat.limit(1)


def test_a_run_says_how_exactly_things_must_lie(lenses: Lenses, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "RESOLUTION", 48)
    monkeypatch.setattr(analysis, "MAP_RESOLUTION", 24)
    run = lenses.shipped("rotating")
    plan = SimpleNamespace(fabrication=None)
    findings = TOLERANCES.compute(plan, run.result)  # type: ignore[arg-type]
    assert findings is not None
    metrics, found = findings.metrics, findings.details
    assert all(0 < value < np.inf for value in metrics.values())
    assert len(metrics) == 12
    # what is measured costs 3 dB where it says so
    posed = PosedLens(run.result.solid, run.result.scene.lens, 48, analysis.SAMPLES)
    for field, pose in (("shift_x_mm", Pose(shift_x_mm=1.0)), ("eye_y_mm", Pose(eye_y_mm=1.0))):
        there = replace(pose, **{field: metrics[f"tolerance_{field}"]})
        back = replace(pose, **{field: -metrics[f"tolerance_{field}"]})
        lost = [
            score(posed.picture(v, Pose()), v.target).psnr_db - score(posed.picture(v, p), v.target).psnr_db
            for v in run.result.scene.views
            for p in (there, back)
        ]
        assert max(lost) == pytest.approx(3.0, abs=0.6)
    assert found.map_db.argmax() in range(13 * 5, 13 * 8), "the sheet's own place is the best, more or less"
    sentences = [f.text for f in check_placing(metrics, run.result.scene.lens, run.result.scene.views[0])]
    assert "lay it within" in sentences[0]
    assert "mm away" in sentences[1]


def test_preflight_is_silent_without_tolerances() -> None:
    scene, _ = slab()
    assert check_placing({}, scene.lens, scene.views[0]) == []


@pytest.mark.tools
def test_poses_are_those_of_mitsuba(lenses: Lenses) -> None:
    """Ten random poses of a real lens: PSNR within half a decibel of a path tracer that looks through the mesh."""
    run = lenses.shipped("single", "lens.gap=1mm")
    scene, solid = run.result.scene, run.result.solid
    rng = np.random.default_rng(1)
    reach = {
        "shift_x_mm": 0.2, "shift_y_mm": 0.2, "rotation_deg": 0.6, "scale_percent": 0.6, "tilt_x_deg": 0.4,
        "tilt_y_deg": 0.4, "gap_mm": 0.5, "eye_x_mm": 4.0, "eye_y_mm": 4.0, "eye_z_mm": 30.0, "ior": 0.01,
    }  # fmt: skip
    posed, [view] = PosedLens(solid, scene.lens, 128, analysis.SAMPLES), scene.views
    for _ in range(10):
        pose = Pose(**{name: float(rng.uniform(-most, most)) for name, most in reach.items()})
        ours = score(posed.picture(view, pose), view.target).psnr_db
        theirs = score(path_traced(scene, solid, view, pose), view.target).psnr_db
        assert ours == pytest.approx(theirs, abs=0.5), pose


def path_traced(scene: Scene, solid: Solid, view: View, pose: Pose) -> FloatArray:
    """The same by Mitsuba: the lens stays, sheet and eye are moved about it."""
    import mitsuba as mi

    from magiclens.rendering.variants import usable_variant

    renderer = Mitsuba(resolution=128, samples=64)
    mi.set_variant(usable_variant("auto"))
    from mitsuba import ScalarTransform4f as Transform

    half = float(np.abs(solid.vertices[solid.vertices[:, 2] == 0][:, :2]).max())
    angle = float(np.hypot(pose.tilt_x_deg, pose.tilt_y_deg))
    axis = [pose.tilt_x_deg / max(angle, 1e-9), pose.tilt_y_deg / max(angle, 1e-9), 0]
    lean = Transform().rotate(axis, angle)
    corners = [lean @ mi.ScalarPoint3f(x, y, 0) for x in (-half, half) for y in (-half, half)]
    to_lens = lean.inverse() @ Transform().translate([0, 0, min(float(corner.z) for corner in corners)])
    eye = to_lens @ mi.ScalarPoint3f(*(view.eye_mm + pose.eye_mm))
    lens = replace(scene.lens, ior=scene.lens.ior + pose.ior)
    world = renderer._world(lens, renderer._lens(solid, lens.ior), replace(view, eye_mm=np.array(eye)))
    side = scene.lens.source_size_mm / 2 * (1 + pose.scale_percent / 100)
    laid = Transform().translate([pose.shift_x_mm, pose.shift_y_mm, -lens.gap_mm - pose.gap_mm])
    world["source"]["to_world"] = (
        to_lens @ laid @ Transform().rotate([0, 0, 1], pose.rotation_deg).scale([side, side, 1])
    )
    return np.asarray(mi.render(mi.load_dict(world), seed=mi.UInt32(0)), np.float32)[..., : view.source.shape[-1]]
