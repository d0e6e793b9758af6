"""From a scenario's words to the views that everything after it works on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from magiclens.config.model import Viewer
from magiclens.contract.artifacts import FloatArray, Lens, View
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image, write_png
from magiclens.images.text import text
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.scenarios.base import Shot
from magiclens.scenarios.multi_view import MultiView
from magiclens.scenarios.pictures import ArtSource, Circles, ImageSource, Target, TextSource
from magiclens.scenarios.rotating import Rotating
from magiclens.scenarios.single import Single
from magiclens.scenarios.stable_zone import StableZone
from toys import SpecWriter

LENS = Lens(size_mm=20, source_size_mm=20, thickness_mm=30)
VIEWER = Viewer.model_validate({"distance": "300mm", "x": "7mm", "y": "-2mm"})
CIRCLES: dict[str, object] = {"type": "circles"}
ART = {
    "grey": lambda size: np.full((size, size, 1), 0.5, np.float32),
    "red": lambda size: np.broadcast_to(np.array([1, 0, 0], np.float32), (size, size, 3)),
}


def single(source: dict[str, object], target: dict[str, object]) -> View:
    (view,) = Single.model_validate({"source": source, "target": target}).make_views(LENS, VIEWER, ART)
    return view


def rotating(**keys: object) -> Rotating:
    return Rotating.model_validate({"source": CIRCLES, **keys})


def test_the_eye_stands_above_the_reference_plane() -> None:
    assert single(CIRCLES, {"art": "grey"}).eye_mm.tolist() == [7, -2, 330]


def test_a_single_view_is_called_single() -> None:
    view = single(CIRCLES, {"art": "grey"})
    assert (view.name, view.rotation_deg, view.source_name, view.target_name) == ("single", 0, "source", "target")


def test_rotations_count_up_in_quarter_turns_by_default() -> None:
    views = rotating(targets=[{"art": "grey"}] * 3).make_views(LENS, VIEWER, ART)
    assert [v.rotation_deg for v in views] == [0, 90, 180]
    assert [v.name for v in views] == [v.target_name for v in views] == ["rotation-000", "rotation-090", "rotation-180"]


def test_a_negative_angle_is_the_turn_it_ends_at() -> None:
    (view,) = rotating(targets=[{"art": "grey"}], angles=["-90deg"]).make_views(LENS, VIEWER, ART)
    assert (view.name, view.rotation_deg, view.quarter_turns) == ("rotation-270", 270, 3)


def test_all_rotations_share_one_source() -> None:
    views = rotating(targets=[{"art": "grey"}] * 2).make_views(LENS, VIEWER, ART)
    assert views[0].source is views[1].source


def test_all_pictures_grey_make_one_channel() -> None:
    view = single(CIRCLES, {"art": "grey"})
    assert view.source.shape[-1] == view.target.shape[-1] == 1


def test_one_coloured_picture_gives_all_three_channels() -> None:
    views = rotating(targets=[{"art": "grey"}, {"art": "red"}]).make_views(LENS, VIEWER, ART)
    assert {p.shape[-1] for v in views for p in (v.source, v.target)} == {3}
    assert views[1].target[0, 0].tolist() == [1, 0, 0]
    assert (np.ptp(views[0].source, axis=-1) == 0).all()


def test_circles_have_15_pixels_per_millimetre_and_come_from_their_seed() -> None:
    pictures = [Circles.model_validate({**CIRCLES, "seed": s}).raster(20, ART) for s in (1, 1, 2)]
    assert pictures[0].shape == (300, 300, 1)
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_coloured_circles_have_colours() -> None:
    assert Circles.model_validate({**CIRCLES, "colours": "coloured"}).raster(5, ART).shape == (75, 75, 3)


def test_large_sources_stop_at_4096_pixels() -> None:
    assert ArtSource.model_validate({"type": "art", "name": "grey"}).raster(1000, ART).shape == (4096, 4096, 1)


@pytest.mark.parametrize(("pixels", "expected"), [(60, 300), (400, 400)])
def test_an_image_source_is_refined_to_15_pixels_per_millimetre(pixels: int, expected: int, tmp_path: Path) -> None:
    path = tmp_path / "source.png"
    write_png(path, np.full((pixels, pixels, 1), 0.5, np.float32))
    source = ImageSource.model_validate({"type": "image", "path": str(path)})
    assert source.raster(20, ART).shape == (expected, expected, 1)


def test_an_oblong_target_is_padded_to_a_square_at_its_own_resolution(grey_png: Path) -> None:
    picture = Target.model_validate({"image": str(grey_png)}).raster(ART)
    assert picture.shape == (60, 60, 1)
    assert picture[0, 0, 0] == 1.0
    assert picture[30, 30, 0] == pytest.approx(read_image(grey_png)[0, 0, 0])


def test_art_targets_have_1024_pixels() -> None:
    assert Target.model_validate({"art": "grey"}).raster(ART).shape == (1024, 1024, 1)


def test_a_text_source_has_15_pixels_per_millimetre_and_fills_all_but_a_margin() -> None:
    source = TextSource.model_validate({"type": "text", "text": "Who?"})
    assert np.array_equal(source.raster(20, ART), text("Who?", 300))
    assert source.raster(1000, ART).shape == (4096, 4096, 1)
    assert str(source) == "text 'Who?'"


def test_a_text_source_keeps_to_its_box() -> None:
    source = TextSource.model_validate({"type": "text", "text": "Who?", "box": ["10%", "0%", "90%", "50%"]})
    picture = source.raster(20, ART)
    assert np.array_equal(picture, text("Who?", 300, (0.1, 0.0, 0.9, 0.5)))
    assert (picture[150:] == 1).all()


def test_text_targets_have_1024_pixels() -> None:
    target = Target.model_validate({"text": "42"})
    assert np.array_equal(target.raster(ART), text("42", 1024))
    assert str(target) == "text '42'"


def test_a_sources_size_becomes_the_lenss() -> None:
    scenario = Single.model_validate({"source": {**CIRCLES, "size": "110mm"}, "target": {"art": "grey"}})
    assert scenario.fitted_lens(LENS, VIEWER).source_size_mm == 110
    assert single(CIRCLES, {"art": "grey"}).source.shape == (300, 300, 1)


def test_sources_of_different_sizes_are_refused() -> None:
    class Two(Single):
        def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
            (shot,) = super().shots(lens, viewer)
            other = Circles.model_validate({**CIRCLES, "size": "1cm"})
            return (shot, Shot("other", other, shot.target, shot.eye_mm, source_name="other"))

    scenario = Two.model_validate({"source": CIRCLES, "target": {"art": "grey"}})
    with pytest.raises(ValueError, match="all sources need the same size, found 10mm, 20mm"):
        scenario.fitted_lens(LENS, VIEWER)


def test_a_plans_scene_has_pictures(write_spec: SpecWriter, registry: Registry) -> None:
    scene = load_plan(write_spec(), registry=registry).scene()
    panda: FloatArray = scene.views[0].target
    assert panda.shape == (1024, 1024, 1)
    assert 0 <= panda.min() < 0.1 < 0.9 < panda.max() <= 1
    assert not np.array_equal(panda, scene.views[1].target)


def seen_from(eye: dict[str, str]) -> list[float]:
    view = {"target": {"art": "grey"}, "eye": eye}
    (shot,) = MultiView.model_validate({"source": CIRCLES, "views": [view]}).shots(LENS, VIEWER)
    return shot.eye_mm.tolist()


@pytest.mark.parametrize(
    ("azimuth", "x", "y"), [(None, 1, 0), ("0deg", 1, 0), ("90deg", 0, 1), ("180deg", -1, 0), ("270deg", 0, -1)]
)
def test_a_tilted_eye_is_as_far_from_the_lenss_centre_as_the_viewer(azimuth: str | None, x: int, y: int) -> None:
    eye = seen_from({"tilt": "30deg"} | ({"azimuth": azimuth} if azimuth else {}))
    assert eye == pytest.approx([150 * x, 150 * y, 30 + 300 * np.sqrt(0.75)])
    assert [str(value) for value in eye if value == 0] == ["0.0"]


def test_an_eye_may_be_placed_beside_the_viewers() -> None:
    assert seen_from({"x": "40mm", "y": "-5mm"}) == [40, -5, 330]
    assert seen_from({"y": "1cm"}) == [0, 10, 330]


def test_all_eyes_share_one_source_and_see_their_own_targets() -> None:
    views = [{"target": {"art": art}, "eye": {"tilt": tilt}} for art, tilt in (("grey", "0deg"), ("red", "5deg"))]
    left, right = MultiView.model_validate({"source": CIRCLES, "views": views}).make_views(LENS, VIEWER, ART)
    assert left.source is right.source
    assert (left.name, right.name, left.target_name, right.target_name) == ("eye-0", "eye-1", "eye-0", "eye-1")
    assert left.target[0, 0].tolist() == [0.5, 0.5, 0.5]
    assert right.target[0, 0].tolist() == [1, 0, 0]


MULTI_VIEW = """\
scenario:
  type: multi-view
  source: {type: circles, seed: 7}
  views:
    - {target: {art: panda}, eye: {tilt: 15deg, azimuth: 180deg}}
    - {target: {art: bat}, eye: {tilt: 15deg}}
lens: {size: 20mm, facets: 4}
"""
STABLE_ZONE = """\
scenario:
  type: stable-zone
  source: {type: circles, seed: 7}
  target: {art: panda}
lens: {size: 20mm, facets: 4}
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("{tilt: 15deg}", "{}", 6, r"scenario\.views\.1\.eye: say where the eye is: \{tilt: 15deg, azimuth: 0deg\} or"),
        ("{tilt: 15deg}", "{tilt: 15deg, x: 3mm}", 6, r"scenario\.views\.1\.eye: say where the eye is"),
        ("{tilt: 15deg}", "{x: 3mm, azimuth: 3deg}", 6, r"scenario\.views\.1\.eye: say where the eye is"),
        ("{tilt: 15deg}", "{tilt: 95deg}", 6, r"scenario\.views\.1\.eye\.tilt: .*80"),
        ("{tilt: 15deg}", "{tilt: 15}", 6, r"scenario\.views\.1\.eye\.tilt: .*15deg"),
        ("{tilt: 15deg}", "{tlit: 15deg}", 6, r"scenario\.views\.1\.eye\.tlit: unknown key; did you mean 'tilt'\?"),
        (", eye: {tilt: 15deg}", "", 6, r"scenario\.views\.1\.eye: this key is required"),
        ("type: circles, seed: 7", "type: circles, seed: 7, size: 10kg", 3, r"scenario\.source\.size: "),
    ],
)
def test_a_wrong_multi_view_spec_gives_one_message(
    write_spec: SpecWriter, old: str, new: str, line: int, message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        load_plan(write_spec((old, new), text=MULTI_VIEW))
    assert f":{line}:" in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("new", "message"),
    [("cone: 0deg", r"\.cone: "), ("cone: 1.15", r"\.cone: .*deg"), ("apex: 1deg", r"\.apex: unknown key.*cone")],
)
def test_a_wrong_stable_zone_gives_one_message(write_spec: SpecWriter, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        load_plan(write_spec(("target: {art: panda}", f"target: {{art: panda}}\n  {new}"), text=STABLE_ZONE))
    assert len(str(error.value).splitlines()) == 1


def test_a_stable_zone_has_nine_eyes_in_a_circular_cross() -> None:
    zone = StableZone.model_validate({"source": CIRCLES, "target": {"art": "grey"}, "cone": "2deg"})
    shots = zone.shots(LENS, VIEWER)
    steps = np.array([shot.eye_mm for shot in shots]) - [7, -2, 330]
    assert [shot.name for shot in shots][:3] == ["centre", "inner-right", "inner-up"]
    away, inner = np.hypot(steps[:, 0], steps[:, 1]), 300 * np.tan(np.radians(1.0))
    assert away[0] == 0
    np.testing.assert_allclose(away[1:5], inner)
    assert np.ptp(away[5:]) < 1e-9
    assert away[5] / inner == pytest.approx(np.sqrt(2), rel=1e-3)
    np.testing.assert_allclose(steps.sum(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(steps[:, 2], 0)
    assert (np.abs(steps[1:5, :2]).min(axis=1) == 0).all()
    np.testing.assert_allclose(*np.abs(steps[5:, :2]).T)
    assert len({shot.target_name for shot in shots}) == len({shot.source_name for shot in shots}) == 1


@pytest.mark.parametrize(("text", "screening"), [(MULTI_VIEW, 1e-3), (STABLE_ZONE, 1e-5)])
def test_several_eyes_come_with_the_matcher_for_them(write_spec: SpecWriter, text: str, screening: float) -> None:
    plan = load_plan(write_spec(text=text))
    assert plan.matcher.stage.type == "multi-view"
    assert plan.annealer.stage.screening == screening  # type: ignore[attr-defined]


def test_lenses_for_several_eyes_bleed_and_lean_out_as_far_as_the_source_reaches(write_spec: SpecWriter) -> None:
    lens = load_plan(write_spec(text=MULTI_VIEW)).lens
    assert (lens.bleed_mm, lens.floor_mm) == (2.5, 20)
    larger = load_plan(write_spec(("seed: 7", "seed: 7, size: 90mm"), text=MULTI_VIEW)).lens
    assert (larger.bleed_mm, larger.floor_mm) == (2.5, 60)
    one = load_plan(write_spec(("    - {target: {art: bat}, eye: {tilt: 15deg}}\n", ""), text=MULTI_VIEW)).lens
    assert (one.bleed_mm, one.floor_mm) == (0, 0)


def test_an_eye_aside_of_a_rotating_lens_is_several_eyes_to_the_lens() -> None:
    turning = rotating(targets=[{"art": "grey"}] * 2)
    lenses = [turning.fitted_lens(LENS, Viewer.model_validate({"distance": "300mm", "x": x})) for x in ("0mm", "7mm")]
    assert [lens.bleed_mm > 0 for lens in lenses] == [False, True]
    shot = turning.shots(LENS, VIEWER)[1]
    view = turning.make_views(LENS, VIEWER, ART)[1]
    np.testing.assert_allclose(shot.eye_in_lens_frame_mm, view.in_lens_frame().eye_mm)


@pytest.mark.parametrize("text", [MULTI_VIEW, STABLE_ZONE])
def test_a_resolved_spec_for_several_eyes_gives_the_same_plan(
    write_spec: SpecWriter, text: str, tmp_path: Path
) -> None:
    plan = load_plan(write_spec(text=text))
    path = tmp_path / "again.yaml"
    YAML().dump(plan.resolved(), path)
    again = load_plan(path)
    assert again.resolved() == plan.resolved()
    assert (again.lens, again.scenario) == (plan.lens, plan.scenario)
