"""From a scenario's words to the views that everything after it works on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magiclens.artifacts import FloatArray, Lens, View
from magiclens.images.files import read_image, write_png
from magiclens.images.text import text
from magiclens.plan import load_plan
from magiclens.registry import Registry
from magiclens.scenarios.base import Shot
from magiclens.scenarios.pictures import ArtSource, Circles, ImageSource, Target, TextSource
from magiclens.scenarios.rotating import Rotating
from magiclens.scenarios.single import Single
from magiclens.spec.model import Viewer
from toys import SpecWriter

LENS = Lens(size_mm=20, source_size_mm=20, thickness_mm=30)
VIEWER = Viewer.model_validate({"distance": "300mm", "x": "7mm", "y": "-2mm"})
CIRCLES: dict[str, object] = {"type": "circles"}
ART = {
    "grey": lambda size: np.full((size, size, 1), 0.5, np.float32),
    "red": lambda size: np.broadcast_to(np.array([1, 0, 0], np.float32), (size, size, 3)),
}


def single(source: dict[str, object], target: dict[str, object]) -> View:
    (view,) = Single.model_validate({"source": source, "target": target}).compiled(LENS, VIEWER, ART)
    return view


def rotating(**keys: object) -> Rotating:
    return Rotating.model_validate({"source": CIRCLES, **keys})


def test_the_eye_stands_above_the_reference_plane() -> None:
    assert single(CIRCLES, {"art": "grey"}).eye_mm.tolist() == [7, -2, 330]


def test_a_single_view_is_called_single() -> None:
    view = single(CIRCLES, {"art": "grey"})
    assert (view.name, view.rotation_deg, view.source_name, view.target_name) == ("single", 0, "source", "target")


def test_rotations_count_up_in_quarter_turns_by_default() -> None:
    views = rotating(targets=[{"art": "grey"}] * 3).compiled(LENS, VIEWER, ART)
    assert [v.rotation_deg for v in views] == [0, 90, 180]
    assert [v.name for v in views] == [v.target_name for v in views] == ["rotation-000", "rotation-090", "rotation-180"]


def test_a_negative_angle_is_the_turn_it_ends_at() -> None:
    (view,) = rotating(targets=[{"art": "grey"}], angles=["-90deg"]).compiled(LENS, VIEWER, ART)
    assert (view.name, view.rotation_deg, view.quarter_turns) == ("rotation-270", 270, 3)


def test_all_rotations_share_one_source() -> None:
    views = rotating(targets=[{"art": "grey"}] * 2).compiled(LENS, VIEWER, ART)
    assert views[0].source is views[1].source


def test_all_pictures_grey_make_one_channel() -> None:
    view = single(CIRCLES, {"art": "grey"})
    assert view.source.shape[-1] == view.target.shape[-1] == 1


def test_one_coloured_picture_gives_all_three_channels() -> None:
    views = rotating(targets=[{"art": "grey"}, {"art": "red"}]).compiled(LENS, VIEWER, ART)
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
    assert scenario.fit(LENS, VIEWER).source_size_mm == 110
    assert single(CIRCLES, {"art": "grey"}).source.shape == (300, 300, 1)


def test_sources_of_different_sizes_are_refused() -> None:
    class Two(Single):
        def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
            (shot,) = super().shots(lens, viewer)
            other = Circles.model_validate({**CIRCLES, "size": "1cm"})
            return (shot, Shot("other", other, shot.target, shot.eye_mm, source_name="other"))

    scenario = Two.model_validate({"source": CIRCLES, "target": {"art": "grey"}})
    with pytest.raises(ValueError, match="all sources need the same size, found 10mm, 20mm"):
        scenario.fit(LENS, VIEWER)


def test_a_plans_scene_has_pictures(write_spec: SpecWriter, registry: Registry) -> None:
    scene = load_plan(write_spec(), registry=registry).scene()
    panda: FloatArray = scene.views[0].target
    assert panda.shape == (1024, 1024, 1)
    assert 0 <= panda.min() < 0.1 < 0.9 < panda.max() <= 1
    assert not np.array_equal(panda, scene.views[1].target)
