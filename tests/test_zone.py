"""The stable viewing zone: where there is one, how it is measured, what a run makes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lenses import Lenses
from magiclens.analysis import stable_zone
from magiclens.analysis.stable_zone import Zone, zone_figures
from magiclens.contract.artifacts import Lens, Scene, Solid, View
from magiclens.contract.hookspecs import hookimpl
from magiclens.drawing.chart import (
    CHART_HEIGHT,
    CHART_WIDTH,
    MARGIN_BOTTOM,
    MARGIN_LEFT,
    MARGIN_RIGHT,
    MARGIN_TOP,
    SHADED_COLOUR,
    Chart,
    ChartAxis,
    Curve,
)
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import score
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Plugin, Registry
from magiclens.rendering.tracer import Tracer
from magiclens.running.pipeline import run_plan
from scenes import THICK, blotches, grey_view, letter_f, small_lens, surface

SOURCE, GLYPH = blotches(120, 3.0), letter_f(64)


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small pictures, which are quick to take."""
    monkeypatch.setattr(stable_zone, "RESOLUTION", 48)


def views_at(*steps: tuple[float, float], **changes: Any) -> tuple[View, ...]:
    """Views of the same pictures from eyes beside the middle."""
    eyes = [(5.0 + x, -3.0 + y, THICK + 400.0) for x, y in ((0.0, 0.0), *steps)]
    return tuple(replace(grey_view(SOURCE, GLYPH, eye), **changes) for eye in eyes)


CROSS = ((4.0, 0.0), (0.0, 4.0), (-4.0, 0.0), (0.0, -4.0), (9.0, 0.0), (-9.0, 0.0))


def scene_of(views: tuple[View, ...], lens: Lens | None = None) -> Scene:
    return Scene(lens or small_lens(), views)


def test_the_eyes_of_a_zone_stand_in_rings_about_the_first() -> None:
    assert stable_zone.rings(scene_of(views_at(*CROSS))) == [4.0, 9.0]
    assert stable_zone.rings(scene_of(views_at(*CROSS, rotation_deg=90.0))) == [4.0, 9.0]


def test_there_is_no_zone_where_eyes_see_different_things_or_do_not_surround_the_first() -> None:
    views = views_at(*CROSS)
    others = {
        "target": replace(views[1], target=1 - views[1].target),
        "source": replace(views[1], source_name="other"),
        "rotation": replace(views[1], rotation_deg=90.0),
        "height": replace(views[1], eye_mm=np.add(views[1].eye_mm, (0, 0, 5))),
    }
    for other in others.values():
        assert stable_zone.rings(scene_of((views[0], other, *views[2:]))) == []
    for few in (views[:1], views[:1] * 3, views[:2], views[1:]):
        assert stable_zone.rings(scene_of(few)) == []


@pytest.mark.parametrize("rings", [[4.0, 10.0], [4.0], [1.0, 2.0, 3.0]])
def test_moves_go_from_the_middle_through_the_rings_and_beyond(rings: list[float]) -> None:
    moves = stable_zone.moves(rings)
    assert (moves[0], moves[-1]) == (0, 1.5 * rings[-1])
    assert {rings[0] / 2, rings[0], rings[-1]} <= set(moves.tolist())
    assert (np.diff(moves) > 0).all()


def slab(lens: Lens) -> Solid:
    return solid_from_heights(surface(lens, np.zeros(1)))


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("rotation", [0.0, 90.0])
def test_a_moved_eye_sees_what_a_view_from_there_shows(rotation: float) -> None:
    lens = small_lens(source=30.0)
    (middle,) = views_at(rotation_deg=rotation)
    moved = replace(middle, eye_mm=np.add(middle.eye_mm, (30.0, -20.0, 0.0)))
    solid = slab(lens)
    expected, plain = Tracer(resolution=48, samples=stable_zone.SAMPLES).render(Scene(lens, (moved, middle)), solid)
    seen = stable_zone.seen_from(Scene(lens, (middle,)), solid, np.array([30.0, -20.0, 0.0]))
    np.testing.assert_array_equal(seen, expected)
    assert score(seen, plain).psnr_db < 30


@pytest.mark.usefixtures("coarse")
def test_quality_is_measured_all_around_for_both_lenses() -> None:
    """The target is what the middle eye sees through a slab, so that every move does harm."""
    lens = small_lens(source=30.0)
    (middle,) = views_at()
    solid = slab(lens)
    target = stable_zone.seen_from(Scene(lens, (middle,)), solid, np.zeros(3))
    views = tuple(replace(view, target=target) for view in views_at(*CROSS))
    first = Scene(lens, views[:1])
    found = stable_zone.measure(Scene(lens, views), solid, first, solid)
    assert (found.distance_mm, found.eyes_mm) == (400.0, [4.0, 9.0])
    for psnr in found.psnr_db.values():
        assert psnr.shape == (len(found.moves_mm), 8)
        assert (psnr[0] > 60).all()
        assert (np.diff(psnr.min(axis=1)) < 0).all()
    np.testing.assert_array_equal(found.psnr_db["zone"], found.psnr_db["plain"])
    step = int(np.flatnonzero(found.moves_mm == 4.0)[0])
    up = score(stable_zone.seen_from(first, solid, np.array([0.0, 4.0, 0.0])), target).psnr_db
    assert found.psnr_db["zone"][step, 2] == pytest.approx(up, abs=1e-6)
    moved = stable_zone.seen_from(first, solid, np.array([8**0.5, 8**0.5, 0.0]))
    np.testing.assert_array_equal(found.pictures["zone"][1], moved)


def made_up(**changes: Any) -> Zone:
    falling = 20.0 - np.arange(4)[:, None] - 0.1 * np.arange(8) * (np.arange(4) > 0)[:, None]
    pictures = [np.full((16, 16, 1), 0.5, np.float32)] * 3
    facts: dict[str, Any] = {
        "distance_mm": 400.0,
        "eyes_mm": [4.0, 8.0],
        "moves_mm": np.array([0.0, 2.0, 4.0, 8.0]),
        "psnr_db": {"zone": falling, "plain": falling + 5 - 4 * np.arange(4)[:, None]},
        "shown_mm": [0.0, 4.0, 8.0],
        "pictures": {"zone": pictures, "plain": pictures},
    }
    return Zone(**facts | changes)


def test_metrics_are_those_of_the_middle_and_of_the_worst_place_within_the_inner_cone() -> None:
    assert made_up().metrics == pytest.approx(
        {
            "zone_centre_psnr_db": 20.0,
            "zone_worst_psnr_db": 17.3,
            "plain_centre_psnr_db": 25.0,
            "plain_worst_psnr_db": 14.3,
        }
    )


def test_moves_are_degrees_at_the_lens() -> None:
    assert made_up().degrees(400.0) == pytest.approx(45.0)
    assert made_up().move_mm(made_up().degrees(7.0)) == pytest.approx(7.0)


def test_a_chart_has_its_points_in_their_places() -> None:
    xs, ys = np.array([0.0, 5.0, 10.0]), np.array([10.0, 30.0, 20.0])
    axes = ChartAxis("x", 0.0, 10.0), ChartAxis("y", 10.0, 30.0)
    draw = Chart(xs, [Curve("c", ys, "#ff0000")], *axes, (0.0, 2.0, "shaded"), [5.0], ("other", {0.5: "half"})).draw()
    assert draw.shape == (CHART_HEIGHT, CHART_WIDTH, 3)
    red = (draw == (255, 0, 0)).all(axis=-1)
    wide, tall = CHART_WIDTH - MARGIN_LEFT - MARGIN_RIGHT, CHART_HEIGHT - MARGIN_TOP - MARGIN_BOTTOM
    for x, y in ((0.0, 10.0), (2.5, 20.0), (5.0, 30.0), (10.0, 20.0)):
        row, column = CHART_HEIGHT - MARGIN_BOTTOM - (y - 10) / 20 * tall, MARGIN_LEFT + x / 10 * wide
        assert red[round(row) - 2 : round(row) + 3, round(column) - 2 : round(column) + 3].any()
    assert not red[CHART_HEIGHT - MARGIN_BOTTOM - 30 : CHART_HEIGHT - MARGIN_BOTTOM, MARGIN_LEFT + wide // 2 :].any()
    shaded = (draw == tuple(bytes.fromhex(SHADED_COLOUR[1:]))).all(axis=-1)[CHART_HEIGHT - MARGIN_BOTTOM - 40]
    assert np.flatnonzero(shaded).max() == pytest.approx(MARGIN_LEFT + 0.2 * wide, abs=2)
    again = Chart(xs, [Curve("c", ys, "#ff0000")], *axes, (0.0, 2.0, "shaded"), [5.0], ("other", {0.5: "half"})).draw()
    np.testing.assert_array_equal(draw, again)


def test_figures_show_both_lenses_from_displaced_eyes() -> None:
    views = views_at(*CROSS)
    found = made_up(pictures={"zone": [views[0].target] * 3, "plain": [0.1 + 0.8 * views[0].target] * 3})
    data = SimpleNamespace(scene=scene_of(views))
    pictures, curve = zone_figures(data, found)  # type: ignore[arg-type]
    assert [len(row) for row in pictures.rows] == [3, 3]
    assert [tile.title for tile in pictures.rows[0]] == [
        "Lens for 7 eyes",
        "eye moved 4.0 mm, 0.57°",
        "eye moved 8.0 mm, 1.1°",
    ]
    above, below = (row[1].caption for row in pictures.rows)
    assert above == "120.0 dB, SSIM 1.00"
    assert float(below.split()[0]) < 40
    (tile,) = curve.rows[0]
    assert tile.caption == "worst within the inner cone: 17.3 dB for 7 eyes, 14.3 dB for the middle eye"


@pytest.mark.tools
@pytest.mark.usefixtures("coarse")
def test_a_run_reports_the_zone_and_leaves_the_lens_alone(lenses: Lenses, tmp_path: Path) -> None:
    without = lenses.shipped("stable-zone")
    assert not [key for key in without.manifest["metrics"] if "plain" in key]
    seen: list[str] = []
    watch = hookimpl(lambda stage: seen.append(stage.kind), specname="mlens_stage_done")
    registry = Registry.load()
    registry.register(SimpleNamespace(mlens_stage_done=watch), Plugin("watcher", "watcher", "1"))
    analyses = "report.analyses=[contact-sheet, stable-zone]"
    run = run_plan(load_plan(without.folder / "spec.yaml", [analyses], registry), tmp_path / "one")
    metrics = run.manifest["metrics"]
    assert {f"{lens}_{which}_psnr_db" for lens in ("zone", "plain") for which in ("centre", "worst")} <= set(metrics)
    assert metrics["plain_worst_psnr_db"] < metrics["plain_centre_psnr_db"] - 2
    assert metrics["zone_centre_psnr_db"] == pytest.approx(run.manifest["views"][0]["psnr_db"], abs=0.5)
    paths = [artifact["path"] for artifact in run.manifest["artifacts"]]
    assert {"figures/stable-zone.png", "figures/stable-zone-curve.png"} <= set(paths)
    with Image.open(run.folder / "figures" / "stable-zone-curve.png") as image:
        assert image.width > CHART_WIDTH
    page = (run.folder / "report.html").read_text(encoding="utf-8")
    assert "From the worst place within the inner cone" in page
    assert set(seen) == {stage["kind"] for stage in run.manifest["stages"]}
    for name in ("lens.stl", "renders/tracer/centre.png", "figures/contact-sheet.png"):
        assert (run.folder / name).read_bytes() == (without.folder / name).read_bytes()
