"""A printed black is not 0: what that changes in matching and in what is seen, and that files keep the full range."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magiclens.config.model import Medium
from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import read_image, score
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.describe import describe_plan
from magiclens.plan.registry import Registry
from magiclens.running.open_run import open_run
from magiclens.running.pipeline import Run, run_spec
from toys import SpecWriter

SPEC = """\
scenario: {type: single, source: {type: circles, radius: [0.5mm, 2mm]}, target: {art: panda}}
lens: {size: 18mm, facets: 6, microfacets: 6, thickness: 20mm}
viewer: {distance: 300mm}
report: {analyses: []}
pipeline:
  annealer: {type: heat-bath, sweeps: 5}
  exporters: [{type: monitor, ppi: 300}]
  renderers: [{type: tracer, resolution: 96}]
"""
UNIVERSAL = """\
scenario: {type: universal-animation, frames: {art: worm, length: 1}, camouflage: {type: noise}}
lens: {size: 18mm, facets: 6, microfacets: 10, thickness: 30mm}
viewer: {distance: 300mm}
report: {analyses: []}
pipeline:
  matcher: {reach: 15%}
  encoder: {iterations: 4}
  exporters: []
  renderers: [{type: tracer, resolution: 96}]
"""
GREYISH = "medium: {black: 15%, white: 80%}\n"


def run(folder: Path, text: str) -> Run:
    folder.mkdir()
    (folder / "a.yaml").write_text(text)
    return run_spec(folder / "a.yaml", folder / "out")


@pytest.fixture(scope="module")
def ideal(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run(tmp_path_factory.mktemp("medium") / "ideal", SPEC)


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run(tmp_path_factory.mktemp("medium") / "printed", SPEC + GREYISH)


def seen(done: Run) -> FloatArray:
    """The tracer's picture, linear light."""
    return np.asarray(done.result.renders["tracer"][0])


def test_a_medium_shows_a_picture_between_its_black_and_its_white() -> None:
    medium = Medium.model_validate({"black": "2%", "white": "90%"})
    assert medium.shown(np.array([0.0, 0.5, 1.0], np.float32)) * 0.9 == pytest.approx([0.02, 0.46, 0.9])
    assert Medium().shown(np.array([0.0, 1.0])).tolist() == [0, 1]


def test_matching_sees_the_medium(ideal: Run, printed: Run) -> None:
    one, other = (done.result.candidates for done in (ideal, printed))
    assert not np.array_equal(one.errors, other.errors)
    assert np.median(other.errors[..., 0]) < np.median(one.errors[..., 0]), "less contrast, smaller differences"
    assert not np.array_equal(one.offsets_mm[..., 0, :], other.offsets_mm[..., 0, :])


def test_predicted_pictures_carry_the_lifted_black(ideal: Run, printed: Run) -> None:
    dark = [np.quantile(seen(done), 0.1) for done in (ideal, printed)]
    assert dark[0] < 0.02
    assert dark[1] == pytest.approx(0.1875 * 0.92, rel=0.1), "black paper through two surfaces"
    assert np.quantile(seen(printed), 0.95) == pytest.approx(0.92, rel=0.05)


def test_scores_are_within_the_mediums_range(printed: Run) -> None:
    view, scene = printed.manifest["views"][0], printed.result.scene
    assert scene.views[0].target.min() == pytest.approx(0.1875, abs=1e-6)
    assert view["psnr_db"] == pytest.approx(score(seen(printed), scene.views[0].target).psnr_db, abs=1e-3)
    assert view["psnr_db"] > score(seen(printed), (scene.views[0].target - 0.1875) / 0.8125).psnr_db + 1


def test_files_keep_the_full_range(ideal: Run, printed: Run) -> None:
    for path in ("sources/source.png", "targets/single.png", "lens.monitor.png"):
        names = [next(done.folder.glob(path.replace("single", "*"))) for done in (ideal, printed)]
        pictures = [read_image(name) for name in names]
        np.testing.assert_array_equal(*pictures)
        assert (pictures[0].min(), pictures[0].max()) == (0, 1)


def test_only_the_contrast_matters(load: Any) -> None:
    bright, dim = (
        load(f"medium={{black: {b}%, white: {w}%}}").on_medium(load().scene()) for b, w in ((10, 80), (5, 40))
    )
    np.testing.assert_allclose(bright.views[0].source, dim.views[0].source, atol=1e-6)
    np.testing.assert_allclose(bright.views[0].target, dim.views[0].target, atol=1e-6)


@pytest.mark.tools
def test_painted_sources_use_the_full_range_and_decoding_carries_the_black(tmp_path: Path) -> None:
    done = run(tmp_path / "universal", UNIVERSAL + GREYISH)
    painted = read_image(done.folder / "sources" / "frame-00.png")
    assert (painted.min(), painted.max()) == (0, 1)
    assert done.result.scene.views[0].source.min() == pytest.approx(0.1875, abs=1e-3)
    (through,) = open_run(done.folder).decode([np.zeros((64, 64, 1), np.float32)])
    assert np.median(through) == pytest.approx(0.1875 * 0.92, rel=0.05)


@pytest.fixture
def load(write_spec: SpecWriter, registry: Registry) -> Any:
    def loaded(*overrides: str) -> Plan:
        return load_plan(write_spec(), overrides, registry)

    return loaded


def test_views_that_share_a_source_go_on_sharing_it(load: Any) -> None:
    plan = load("medium={black: 3%}")
    given = plan.scene()
    shown = plan.on_medium(given)
    assert shown.views[0].source is shown.views[1].source
    assert shown.views[0].source.dtype == np.float32
    assert replace(shown, views=given.views) == replace(given, views=given.views)
    assert given.views[0].source.min() == 0


def test_without_a_medium_nothing_changes(load: Any) -> None:
    plan = load()
    scene = plan.scene()
    assert plan.on_medium(scene) is scene
    assert "medium" not in plan.resolved()


def test_a_medium_is_part_of_plan_and_resolved_spec(load: Any) -> None:
    plan = load("medium={black: 3%}")
    assert plan.resolved()["medium"] == {"black": "3%", "white": "100%"}
    assert "medium   black reflects 3 % of the light, white 100 %" in describe_plan(plan)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("medium.black=3", "medium.black: 3 is a bare number; a share needs a unit, such as '3%'"),
        ("medium={black: 90%, white: 20%}", "medium.white: white must be brighter than black, more than 90%"),
        ("medium.white=120%", "medium.white: must be at most 100%, got '120%'"),
        ("medium.blak=3%", "medium.blak: unknown key; did you mean 'black'?"),
    ],
)
def test_impossible_media_are_named(override: str, message: str, load: Any) -> None:
    with pytest.raises(InputError, match=re.escape(f"--set {override}: {message}")):
        load(override)


def test_the_glass_of_a_screen_is_air_that_moves_rays_as_much(tmp_path: Path) -> None:
    """A ray at 10 degrees, through 0.7 mm of glass: to a hundredth of the way by Snell's law."""
    spec = tmp_path / "a.yaml"
    spec.write_text(SPEC + "medium: {glass: 0.7mm}\n", encoding="utf-8")
    plan = load_plan(spec)
    inside = np.arcsin(np.sin(np.radians(10)) / 1.52)
    assert plan.lens.gap_mm * np.tan(np.radians(10)) == pytest.approx(0.7 * np.tan(inside), rel=0.01)
    assert "below 0.7 mm of glass" in describe_plan(plan)
    assert load_plan(spec, ["lens.gap=2mm"]).lens.gap_mm == pytest.approx(2 + 0.7 / 1.52)
