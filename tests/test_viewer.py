"""The viewer in a real browser, over file://, against the built-in tracer."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import time
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image, ImageSequence
from playwright.sync_api import Browser, CDPSession, Page
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

import magiclens.web.viewer
from browsers import listen
from lenses import Lenses
from magiclens.cli import app
from magiclens.contract.artifacts import FloatArray, Lens, View
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import read_image, resize, to_display, to_linear
from magiclens.images.files import write_png
from magiclens.images.movies import read_frames
from magiclens.images.score import psnr_db
from magiclens.rendering.tracer import picture, trace
from magiclens.running.open_run import OpenRun, open_run
from magiclens.scenarios.base import Shot
from magiclens.scenarios.pictures import Circles, Target
from magiclens.web.embedding import json_for_script
from magiclens.web.viewer import MOST_BYTES, viewer_fragment, viewer_page
from magiclens.web.viewer.film import FILM_BYTES, film_uri
from magiclens.web.viewer.packing import orthonormal_polynomials, pack_heights, unpack_heights
from magiclens.web.viewer.page import _SCRIPTS
from magiclens.web.viewer.pictures import picture_uri_within
from magiclens.web.viewer.viewer_data import LANDING_MM, finest_step_mm, keep_views, view_labels

PIXELS, SAMPLES = 128, 2
SIDE_MM = 25.0
"""Of the small lenses."""
LENSES = {
    "rotating": (),
    "multi-view": (),
    "milled": ("lens.gap=30mm", "medium={black: 10%, white: 80%}"),
}
"""By shipped spec: what its small lens has of its own here."""
CHANGES = {
    "shifted": {"x": 3.0, "y": -2.0},
    "turned": {"angle": 5.0},
    "lifted": {"lift": 6.0},
    "another eye": {"eyeX": 45.0, "eyeY": -30.0},
    "all at once": {"x": -4.0, "y": 2.5, "angle": -13.0, "lift": 4.0, "eyeX": -60.0, "eyeDistance": -60.0},
}
Pose = dict[str, float]


@pytest.fixture(scope="module")
def folders(lenses: Lenses, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs of small lenses, each with its view.html."""
    made = {name: tmp_path_factory.mktemp("runs") / name for name in LENSES}
    for name, folder in made.items():
        shutil.copytree(lenses.shipped(name, *LENSES[name]).folder, folder)
        done = CliRunner().invoke(app, ["view", str(folder), "--no-open"])
        assert done.exit_code == 0, done.output
    return made


@pytest.fixture
def visit(browser: Browser, folders: dict[str, Path]) -> Iterator[Any]:
    """Opens a run's viewer; fails at the end if the page complained or asked for anything but itself."""
    contexts, complaints = [], []

    def opened(
        name: str | Path = "rotating", width: int = 340, height: int = 600, script: str = "", **options: Any
    ) -> Page:
        options = {"reduced_motion": "reduce"} | options
        contexts.append(browser.new_context(viewport={"width": width, "height": height}, **options))
        tab = contexts[-1].new_page()
        folder = name if isinstance(name, Path) else folders[name]
        address = (folder / "view.html").as_uri()
        complaints.append(listen(tab, address))
        if script:
            tab.add_init_script(script)
        tab.goto(address)
        if not script:
            tab.evaluate("magiclens.ready")
        return tab

    yield opened
    for context in contexts:
        context.close()
    assert not any(complaints)


def captured(tab: Page, view: int, poses: list[Pose]) -> FloatArray:
    """(len(poses), PIXELS, PIXELS, 3) linear light of the lens's own square over the source of a view."""
    script = f"""([view, poses]) => {{
        magiclens.show(view);
        return poses.map((pose) => (magiclens.setPose(pose), magiclens.capture({PIXELS}, {SAMPLES})));
    }}"""
    return np.array(tab.evaluate(script, [view, poses])).reshape(-1, PIXELS, PIXELS, 3)


def home(view: View, thickness_mm: float) -> Pose:
    """Where lens and eye are when the view's target appears."""
    x, y, z = view.eye_mm.tolist()
    eye = {"eyeX": x, "eyeY": y, "eyeDistance": z - thickness_mm}
    return {"x": 0.0, "y": 0.0, "angle": view.rotation_deg, "lift": 0.0, **eye}


def turned(points: FloatArray, degrees: float) -> FloatArray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return points @ np.array([[c, s], [-s, c]])


def traced(lens: OpenRun, view: View, pose: Pose, pixels: int = PIXELS) -> FloatArray:
    """What the built-in tracer sees of a moved lens; the lens stays where it is, eye and source move instead."""
    x, y, height = pose["eyeX"], pose["eyeY"], lens.plan.lens.thickness_mm + pose["eyeDistance"]
    at = np.array([pose["x"], pose["y"]])
    eye = np.array([*turned(np.array([x, y]) - at, -pose["angle"]), height - pose["lift"]])
    moved = replace(lens.plan.lens, gap_mm=lens.plan.lens.gap_mm + pose["lift"])
    hits = trace(lens.solid, moved, replace(view, eye_mm=eye, rotation_deg=0.0), pixels, SAMPLES)
    hits[..., :2] = turned(hits[..., :2], pose["angle"]) + at
    return picture(hits, view.source, moved.source_size_mm)


def likeness(seen: FloatArray, wanted: FloatArray) -> float:
    return psnr_db(*np.broadcast_arrays(to_display(seen), to_display(wanted)))


def smooth_heights(facets: int, lines: int) -> FloatArray:
    """Every facet bends its own way, as lenslets do."""
    x = np.linspace(-1, 1, lines)
    bend = np.random.default_rng(0).normal(size=(3, facets, facets, 1, 1))
    return bend[0] + 0.3 * bend[1] * x**2 + 0.2 * bend[2] * x * x[:, None]


def test_packed_heights_are_right_to_a_tenth_of_a_micrometre() -> None:
    heights = smooth_heights(6, 9) + 0.05 * np.random.default_rng(1).normal(size=(6, 6, 9, 9))
    np.testing.assert_allclose(unpack_heights(pack_heights(heights, 2e-5, 100_000), 6, 9), heights, atol=1e-4)


def test_smooth_facets_take_a_few_bytes_each() -> None:
    assert len(pack_heights(smooth_heights(16, 23), 1e-4, 100_000).content) < 20 * 16**2


def test_rough_heights_are_packed_more_coarsely_when_there_is_little_room() -> None:
    heights = np.random.default_rng(0).normal(size=(8, 8, 5, 5))
    packed = pack_heights(heights, 1e-5, 3000)
    assert 2500 < len(packed.content) <= 3000
    assert unpack_heights(packed, 8, 5) == pytest.approx(heights, abs=0.3)


def test_polynomials_are_orthonormal_to_the_highest_degree() -> None:
    basis = orthonormal_polynomials(61)
    np.testing.assert_allclose(basis @ basis.T, np.eye(61), atol=1e-12)
    assert (basis[:, -1] > -1e-15).all()  # the last ones are 0, but for rounding


@pytest.mark.parametrize("gap", [0.0, 100.0])
def test_micro_facets_that_turn_one_by_one_still_send_light_where_it_belongs(gap: float) -> None:
    lens = Lens(facets=8, microfacets=22, size_mm=25.0, gap_mm=gap)
    slopes = 0.05 * np.random.default_rng(0).normal(size=(8, 8, 23, 23))
    heights = smooth_heights(8, 23) + np.cumsum(slopes, axis=3) * lens.pitch_mm / 22
    error = unpack_heights(pack_heights(heights, finest_step_mm(lens), 10**6), 8, 23) - heights
    way = (lens.ior - 1) * (lens.thickness_mm / lens.ior + gap)
    for axis in (2, 3):
        landing = np.diff(error, axis=axis) / (lens.pitch_mm / 22) * way
        assert 0.5 * LANDING_MM < np.sqrt((landing**2).mean()) < 1.1 * LANDING_MM


@pytest.mark.parametrize("most", [200_000, 20_000, 900])
def test_a_picture_fits_into_the_bytes_that_it_is_given(tmp_path: Path, most: int) -> None:
    noise = np.random.default_rng(0).random((128, 128, 3)).astype(np.float32)
    write_png(tmp_path / "noise.png", noise)
    assert len(picture_uri_within(tmp_path / "noise.png", most)) <= most * 4 / 3 + 40


def test_photographs_are_kept_well_or_at_least_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photograph = gaussian_filter(np.random.default_rng(0).random((128, 128, 3)), (1, 1, 0)).astype(np.float32)
    write_png(tmp_path / "a.png", photograph)
    content = picture_uri_within(tmp_path / "a.png", 15_000)
    assert content.startswith("data:image/avif;")
    assert psnr_db(shown(content), to_display(photograph)) > 35
    monkeypatch.delitem(Image.SAVE, "AVIF")
    content = picture_uri_within(tmp_path / "a.png", 15_000)
    assert content.startswith("data:image/webp;")
    assert psnr_db(shown(content), to_display(photograph)) > 25


def shown(uri: str) -> FloatArray:
    """(H, W, 3) display values of a picture in a data URI."""
    with Image.open(BytesIO(b64decode(uri.partition(",")[2]))) as image:
        return np.asarray(image.convert("RGB"), np.float32) / 255


@pytest.mark.tools
def test_of_many_frames_some_are_kept_evenly(folders: dict[str, Path]) -> None:
    view = open_run(folders["rotating"]).scene.views[0]
    film = tuple(replace(view, name=f"frame-{k}", source_name=f"frame-{k}") for k in range(40))
    assert [view.name for view in keep_views(film, 4)] == ["frame-0", "frame-10", "frame-20", "frame-30"]
    assert len(keep_views(film, 99)) == 40


@pytest.mark.tools
def test_nothing_in_the_page_can_be_taken_for_markup(folders: dict[str, Path]) -> None:
    text = viewer_page(folders["rotating"], '</title><script>alert("hi")</script>')
    assert "<script>alert" not in text
    assert json.loads(json_for_script({"</script>": "<!--"})) == {"</script>": "<!--"}
    assert "<" not in json_for_script({"</script>": "<!--"})


def test_parts_of_the_script_share_no_variable_that_changes() -> None:
    templates = Path(magiclens.web.viewer.__file__).parent / "templates"
    scripts = {path.name: path.read_text(encoding="utf-8") for path in templates.glob("*.js")}
    assert set(scripts) == set(_SCRIPTS), "every part is in the page, and nothing else"
    shared = {name: re.findall(r"^(?:let|var) .*", text, re.MULTILINE) for name, text in scripts.items()}
    assert not any(shared.values()), shared


@pytest.mark.tools
def test_a_fragment_is_one_section_of_bounded_size_that_names_no_other_place(folders: dict[str, Path]) -> None:
    for folder in folders.values():
        text = viewer_fragment(folder)
        assert text.startswith("<section")
        assert text.rstrip().endswith("</section>")
        assert len(text.encode()) <= MOST_BYTES
        assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)|url\(|https?://|\bfetch\(|\bimport\b""", text)


@pytest.mark.tools
def test_the_command_lists_its_page_in_the_manifest(folders: dict[str, Path]) -> None:
    manifest = json.loads((folders["rotating"] / "manifest.json").read_text())
    assert "view.html" in [file["path"] for file in manifest["artifacts"]]


@pytest.mark.tools
def test_the_command_says_what_is_wrong(folders: dict[str, Path], tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("manifest.json", "spec.yaml"):
        shutil.copy(folders["rotating"] / name, bare)
    for arguments, message in (
        ([tmp_path], "is not a run folder"),
        ([bare], "there is no heights.npz"),
        ([folders["rotating"], "-o", tmp_path], "is a folder; name a file"),
    ):
        done = CliRunner().invoke(app, ["view", "--no-open", *map(str, arguments)])
        assert done.exit_code == 2
        assert message in done.output
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["bare", "manifest.json", "spec.yaml"]


def test_values_that_the_lens_bears_are_marked(folders: dict[str, Path], browser: Browser, tmp_path: Path) -> None:
    """Where the run has measured tolerances; elsewhere nothing is."""
    copy = tmp_path / "run"
    shutil.copytree(folders["rotating"], copy)
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))
    limits = {"shift_x_mm": 1.0, "shift_y_mm": 1.0, "rotation_deg": 3.0, "gap_mm": 0.7}
    limits |= {"eye_x_mm": 4.0, "eye_y_mm": 4.0, "eye_nearer_mm": 20.0, "eye_farther_mm": 30.0}
    manifest["metrics"] |= {f"tolerance_{name}": value for name, value in limits.items()}
    (copy / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    for folder, marked in ((copy, "1110101"), (folders["rotating"], "0000000")):
        page = tmp_path / "view.html"
        page.write_text(viewer_page(folder), encoding="utf-8")
        tab = browser.new_page(reduced_motion="reduce")
        tab.goto(page.as_uri())
        tab.evaluate("magiclens.ready")
        tab.evaluate("magiclens.setPose({x: 0.5, y: -1, angle: -2, lift: 1, eyeX: 4, eyeY: 5, eyeDistance: 425})")
        tab.evaluate("magiclens.settled()")
        outputs = "[...document.querySelectorAll('[data-part=sliders] output')]"
        found = tab.evaluate(f"{outputs}.map((output) => Number(output.classList.contains('mlens-good')))")
        assert "".join(map(str, found)) == marked
        tab.close()


@pytest.mark.parametrize("name", list(LENSES))
def test_in_its_place_the_lens_shows_what_the_tracer_saw(visit: Any, folders: dict[str, Path], name: str) -> None:
    tab = visit(name)
    for k, view in enumerate(open_run(folders[name]).scene.views):
        (seen,) = captured(tab, k, [{}])
        assert tab.evaluate("magiclens.atHome()")
        wanted = read_image(folders[name] / f"renders/tracer/{view.name}.png")
        assert likeness(np.rot90(seen, view.quarter_turns), wanted) > 37


@pytest.mark.parametrize("name", list(LENSES))
def test_out_of_its_place_the_lens_shows_what_the_tracer_sees(visit: Any, folders: dict[str, Path], name: str) -> None:
    lens = open_run(folders[name])
    views = lens.plan.on_medium(lens.printed_scene).views
    at_home = home(views[-1], lens.plan.lens.thickness_mm)
    poses = [{key: at_home[key] + change.get(key, 0.0) for key in at_home} for change in CHANGES.values()]
    first, *seen = captured(visit(name), len(views) - 1, [at_home, *poses])
    for picture_, pose, change in zip(seen, poses, CHANGES, strict=True):
        assert likeness(picture_, traced(lens, views[-1], pose)) > 33, change
        assert likeness(picture_, first) < 25, change


def test_a_lens_with_a_printer_is_shown_as_printed_and_on_request_as_designed(
    visit: Any, lenses: Lenses, tmp_path: Path
) -> None:
    printed = open_run(lenses.shipped("printed-single").folder)
    (tmp_path / "view.html").write_text(viewer_page(printed.folder), encoding="utf-8")
    tab, view = visit(tmp_path), printed.printed_scene.views[0]
    wanted = {"As printed": printed.top_as_made, "As designed": printed.top}
    seen = {}
    for name, top in wanted.items():
        tab.get_by_role("radio", name=name).check(force=True)
        tab.wait_for_timeout(500)
        (seen[name],) = captured(tab, 0, [{}])
        hits = trace(solid_from_heights(top), printed.plan.lens, view, PIXELS, SAMPLES)
        assert likeness(seen[name], picture(hits, view.source, printed.plan.lens.source_size_mm)) > 33, name
    assert likeness(*seen.values()) < 25


def shown_in_place(tab: Page) -> FloatArray:
    """A screenshot of where the lens belongs: display values."""
    tab.evaluate("magiclens.settled()")
    content = tab.screenshot(clip=tab.evaluate("magiclens.square()"))
    return np.asarray(Image.open(BytesIO(content)).convert("RGB"), np.float32) / 255


def looks_like(tab: Page, folder: Path) -> float:
    """Of what is seen where the lens belongs, but for the line around it, and what the tracer sees there, in dB."""
    lens = open_run(folder)
    view = lens.printed_scene.views[0]
    shot = shown_in_place(tab)
    wanted = traced(lens, view, home(view, lens.plan.lens.thickness_mm), len(shot))
    inner = (slice(2, -2), slice(2, -2))
    return likeness(to_linear(shot)[inner], np.broadcast_to(wanted, shot.shape)[inner])


def drag(tab: Page, steps: int = 6) -> None:
    """Take the lens by its middle and let go of it nearly where it belongs."""
    place, pose = tab.evaluate("magiclens.square()"), tab.evaluate("magiclens.pose()")
    per_mm, x, y = place["width"] / SIDE_MM, place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    tab.mouse.move(x + pose["x"] * per_mm, y - pose["y"] * per_mm)
    tab.mouse.down()
    tab.mouse.move(x + 0.9 * per_mm, y - 0.7 * per_mm, steps=steps)
    tab.mouse.up()


def test_a_lens_dragged_onto_its_outline_shows_the_target(visit: Any, folders: dict[str, Path]) -> None:
    tab = visit(width=640)
    assert tab.locator('[data-part="hint"]').inner_text() == "Drag the lens onto the outline"
    assert looks_like(tab, folders["rotating"]) < 15
    drag(tab)
    assert looks_like(tab, folders["rotating"]) > 25
    tab.wait_for_function("document.querySelector('[data-part=readout]').textContent === 'In place: heart.'")
    assert tab.locator('[data-part="hint"]').inner_text() == "Now turn it: there is more to see"


def touch(session: CDPSession, kind: str, *points: tuple[float, float]) -> None:
    session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})


def test_on_a_phone_a_finger_moves_the_lens_and_nothing_is_cut_off(visit: Any, folders: dict[str, Path]) -> None:
    tab = visit(width=375, height=812, has_touch=True, is_mobile=True)
    assert tab.evaluate("document.documentElement.scrollWidth") == 375
    place, session = tab.evaluate("magiclens.square()"), tab.context.new_cdp_session(tab)
    pose, per_mm = tab.evaluate("magiclens.pose()"), place["width"] / SIDE_MM
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    for k in range(7):
        far = per_mm * (1 - k / 6)
        touch(session, "touchMove" if k else "touchStart", (x + pose["x"] * far, y - pose["y"] * far))
    touch(session, "touchEnd")
    assert tab.evaluate("magiclens.atHome()")
    assert tab.evaluate("scrollY") == 0
    assert looks_like(tab, folders["rotating"]) > 25


def test_two_fingers_turn_and_lift(visit: Any) -> None:
    tab = visit(width=375, height=812, has_touch=True, is_mobile=True)
    tab.evaluate("magiclens.show(0)")
    place, session = tab.evaluate("magiclens.square()"), tab.context.new_cdp_session(tab)
    x, y, far = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2, place["width"] / 4
    touch(session, "touchStart", (x - far, y))
    touch(session, "touchStart", (x - far, y), (x + far, y))
    for k in range(1, 7):
        angle, reach = math.radians(7 * k), far * (1 + k / 12)
        ends = (reach * math.cos(angle), reach * math.sin(angle))
        touch(session, "touchMove", (x - ends[0], y + ends[1]), (x + ends[0], y - ends[1]))
    touch(session, "touchEnd")
    pose = tab.evaluate("magiclens.pose()")
    assert pose["angle"] == pytest.approx(42, abs=2)
    assert pose["lift"] == pytest.approx(0.5 * 0.4 * SIDE_MM, rel=0.1)


def test_the_keyboard_alone_brings_the_lens_home_and_opens_everything(visit: Any) -> None:
    tab = visit()
    for _ in range(4):
        tab.keyboard.press("Tab")
        if tab.evaluate("document.activeElement.tagName") == "CANVAS":
            break
    assert tab.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    tab.evaluate("magiclens.setPose({x: 7, y: -6, angle: -9, lift: 2})")
    for keys in ("Shift+ArrowLeft", *["ArrowLeft"] * 2, "Shift+ArrowUp", "ArrowUp", "Shift+Q", *"qqq", *"--"):
        tab.keyboard.press(keys)
    assert tab.evaluate("magiclens.atHome()")
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("magiclens.pose().x") == 1
    tab.keyboard.press("w")
    assert tab.evaluate("magiclens.pose().eyeY") == 5
    tab.keyboard.press("Enter")
    assert tab.evaluate("magiclens.atHome()")
    tab.keyboard.press("Shift+Tab")
    tab.keyboard.press("ArrowRight")
    assert tab.locator("#mlens-panel-solid").is_visible()
    tab.keyboard.press("Tab")
    before = canvas(tab)
    tab.keyboard.press("ArrowLeft")
    assert (canvas(tab) != before).any()


def test_every_view_can_be_chosen(visit: Any) -> None:
    tab = visit()
    tab.get_by_role("radio", name="star").check(force=True)
    assert tab.evaluate("[magiclens.view(), magiclens.pose().angle, magiclens.atHome()]") == [1, 90, True]
    tab.evaluate("magiclens.setPose({angle: 3})")
    assert not tab.evaluate("magiclens.atHome()")
    tab.evaluate("magiclens.setPose({angle: 0})")
    assert tab.evaluate("[magiclens.view(), magiclens.atHome()]") == [0, True]


def test_views_are_called_by_their_pictures_or_by_their_own_names_where_these_are_alike() -> None:
    def shot(name: str, **target: str) -> Shot:
        return Shot(name, Circles(type="circles"), Target(**target), np.array([0.0, 0.0, 400.0]))

    shots = (shot("eye-0", art="bat"), shot("eye-1", text="42"), shot("up-left", art="cat"), shot("down", art="cat"))
    assert view_labels(shots) == {"eye-0": "bat", "eye-1": "42", "up-left": "up left", "down": "down"}


def test_a_link_leads_to_the_pose_that_it_was_copied_at(visit: Any) -> None:
    tab = visit()
    tab.evaluate("magiclens.show(1), magiclens.setPose({x: 3.25, angle: 97, eyeY: 12})")
    tab.get_by_role("button", name="Copy a link to this").click()
    address, pose = tab.evaluate("location.href"), tab.evaluate("magiclens.pose()")
    assert address.endswith("#view=1&x=3.25&angle=97&eyeY=12")
    other = visit()
    other.goto("about:blank")
    other.goto(address)
    other.evaluate("magiclens.ready")
    assert other.evaluate("magiclens.pose()") == pose
    assert other.evaluate("magiclens.view()") == 1
    for wrong in ("#view=9", "#view=no", "#view=1&x=much", "#files"):
        other.goto("about:blank")
        other.goto(address.partition("#")[0] + wrong)
        other.evaluate("magiclens.ready")
        assert math.isfinite(other.evaluate("magiclens.pose().x")), wrong


def test_at_the_start_the_sheet_lies_free(visit: Any) -> None:
    for size in ({"width": 1100}, {"width": 375, "height": 812}):
        tab = visit(**size)
        place, pose = tab.evaluate("magiclens.square()"), tab.evaluate("magiclens.pose()")
        per_mm, away = place["width"] / SIDE_MM, max(abs(pose["x"]), abs(pose["y"]))
        assert away > SIDE_MM
        stage = tab.locator("[data-part=stage]").bounding_box()
        half = 0.52 * place["width"]
        x = place["x"] + place["width"] / 2 + pose["x"] * per_mm
        y = place["y"] + place["height"] / 2 - pose["y"] * per_mm
        assert stage["x"] < x - half
        assert x + half < stage["x"] + stage["width"]
        assert y + half < stage["y"] + stage["height"]


def test_without_a_gpu_dragging_is_smooth_and_rest_is_sharp(visit: Any) -> None:
    tab = visit(width=1440, height=1000)
    tab.evaluate("magiclens.settled()")
    place, pose = tab.evaluate("magiclens.square()"), tab.evaluate("magiclens.pose()")
    per_mm, y = place["width"] / SIDE_MM, place["y"] + place["height"] / 2
    tab.mouse.move(place["x"] + place["width"] / 2 + pose["x"] * per_mm, y - pose["y"] * per_mm)
    full = tab.evaluate("document.querySelector('.mlens canvas').width")
    tab.mouse.down()
    before, began, widths = tab.evaluate("magiclens.progress().pictures"), time.monotonic(), []
    while time.monotonic() - began < 2:
        tab.mouse.move(place["x"] + 80 * math.sin(5 * time.monotonic()), y + 60 * math.cos(5 * time.monotonic()))
        tab.wait_for_timeout(15)
        widths.append(tab.evaluate("document.querySelector('.mlens canvas').width"))
    rate = (tab.evaluate("magiclens.progress().pictures") - before) / (time.monotonic() - began)
    tab.mouse.up()
    began = time.monotonic()
    tab.wait_for_function("magiclens.progress().sharp", polling=20)
    rest, crowd = time.monotonic() - began, os.getloadavg()[0] / (os.cpu_count() or 1)
    # where others keep the processors busy, it can only give up what it has: pixels
    assert rate > 10 or (crowd > 1.5 and min(widths) < 0.4 * full), f"{rate:.1f} a second"
    assert rest < 2 * max(crowd, 1)


def test_lens_and_eye_glide_unless_motion_is_unwelcome(visit: Any) -> None:
    for motion, arrives in (("reduce", True), ("no-preference", False)):
        tab = visit(reduced_motion=motion)
        arrived = tab.evaluate("document.querySelector('[data-part=home]').click(), magiclens.atHome()")
        assert arrived == arrives
        tab.wait_for_function("magiclens.atHome()")


def canvas(tab: Page) -> FloatArray:
    tab.evaluate("magiclens.settled()")
    return np.asarray(Image.open(BytesIO(tab.locator("canvas").screenshot())).convert("RGB"))


def test_the_solid_is_coloured_and_cut_open(visit: Any) -> None:
    tab = visit()
    tab.get_by_role("tab", name="The lens").click()
    looks = [canvas(tab)]
    for name in ("Slopes", "Steps"):
        tab.get_by_role("radio", name=name).check(force=True)
        looks.append(canvas(tab))
    assert re.fullmatch(r"\d+\.\d\d mm", tab.locator('[data-part="most"]').inner_text())
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert (looks[a] != looks[b]).any(axis=-1).mean() > 0.02
    tab.get_by_role("slider", name="Section", exact=True).fill("50")
    assert tab.locator("[data-part=cuts] output").first.inner_text() == "at 50 %"
    cut = canvas(tab)
    red, _, blue = np.moveaxis(cut.astype(int), -1, 0)
    assert (red > blue + 60).mean() > 0.02
    assert (cut != looks[0]).any(axis=-1).mean() > 0.1, "what is cut off shows what lies behind"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_stands_in_the_way_of_those_who_see_or_move_otherwise(visit: Any, scheme: str) -> None:
    tab = visit(color_scheme=scheme)
    tab.locator("summary").click()
    for name in ("On the table", "The lens"):
        tab.get_by_role("tab", name=name).click()
        found = Axe().run(tab).response["violations"]
        assert [rule["id"] for rule in found] == []


def test_dark_rooms_have_a_dark_table(visit: Any) -> None:
    bright, dark = (canvas(visit(color_scheme=scheme))[5, 5].mean() for scheme in ("light", "dark"))
    assert bright > 150 > 100 > dark


def test_frames_of_a_film_are_scrubbed_and_played(
    visit: Any, folders: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magiclens.web.viewer.viewer_data.MOST_CHOICES", 0)
    (tmp_path / "view.html").write_text(viewer_page(folders["rotating"]), encoding="utf-8")
    tab = visit(tmp_path)
    tab.get_by_role("slider", name="Frame").fill("1")
    assert tab.evaluate("magiclens.view()") == 1
    tab.get_by_text("Frame 2 of 2").wait_for()
    tab.get_by_role("button", name="Play").click()
    tab.wait_for_function("magiclens.view() === 0")
    tab.get_by_role("button", name="Stop").click()
    now = tab.evaluate("magiclens.view()")
    tab.wait_for_timeout(800)
    assert tab.evaluate("magiclens.view()") == now


def test_a_lost_picture_is_drawn_again(visit: Any) -> None:
    tab = visit()
    before = canvas(tab)
    tab.evaluate(
        """() => new Promise((done) => {
            const canvas = document.querySelector("canvas");
            const loser = canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
            canvas.addEventListener("webglcontextlost", () => setTimeout(() => loser.restoreContext(), 50));
            canvas.addEventListener("webglcontextrestored", () => setTimeout(done, 1000));
            loser.loseContext();
        })"""
    )
    np.testing.assert_allclose(canvas(tab), before, atol=2)


def test_without_webgl_there_is_a_film_or_a_picture_and_a_reason(visit: Any) -> None:
    for motion, side in (("reduce", 320), ("no-preference", 240)):
        tab = visit(script="HTMLCanvasElement.prototype.getContext = () => null", reduced_motion=motion)
        tab.get_by_text("this browser offers no WebGL2").wait_for()
        picture = tab.locator(".mlens-plain img")
        assert picture.is_visible()
        assert picture.evaluate("(image) => image.decode().then(() => image.naturalWidth)") == side
        assert not tab.locator("canvas").is_visible()
        again = tab.get_by_role("button", name="Show it again")
        assert again.is_visible() == (motion != "reduce")
        if motion != "reduce":
            before = picture.evaluate("(image) => image.currentSrc")
            again.click()
            tab.wait_for_function("(old) => document.querySelector('.mlens-plain img').currentSrc !== old", arg=before)


@pytest.mark.tools
def test_the_film_for_old_browsers_begins_with_the_sheet_and_ends_with_what_the_tracer_sees(
    folders: dict[str, Path],
) -> None:
    for name, folder in folders.items():
        uri = film_uri(open_run(folder))
        assert len(uri) <= FILM_BYTES
        with Image.open(BytesIO(b64decode(uri.partition(",")[2]))) as film:
            assert film.info["loop"] == 1
            frames, shown_ms = [], 0.0
            for frame in ImageSequence.Iterator(film):
                frames.append(np.asarray(frame.convert("RGB"), np.float32) / 255)
                shown_ms += frame.info["duration"]
        assert shown_ms < 5000, "longer motion needs a button to stop it"
        lens = open_run(folder)
        view = lens.scene.views[-1]
        side = round(240 * SIDE_MM / wide_mm(lens, view))
        corner = round(120 - side / 2)
        wanted = to_display(np.broadcast_to(lens.seen(name=view.name, resolution=side), (side, side, 3)))
        inner = frames[-1][corner : corner + side, corner : corner + side]
        assert psnr_db(inner, wanted) > 20, name
        assert psnr_db(frames[-2], frames[-1]) < 20, "the lens comes in"


def wide_mm(lens: OpenRun, view: View) -> float:
    """How wide the picture of a film is."""
    near = view.eye_mm[2] - lens.plan.lens.thickness_mm
    sheet = lens.plan.lens.source_size_mm * near / (view.eye_mm[2] + lens.plan.lens.gap_mm)
    return float(1.1 * min(max(sheet, SIDE_MM), 1.4 * SIDE_MM))


NO_H264 = """
    const asked = VideoEncoder.isConfigSupported.bind(VideoEncoder);
    VideoEncoder.isConfigSupported = (it) => (it.codec.startsWith("avc1") ? { supported: false } : asked(it));
"""
FILM_KINDS = {"h264": "0", "vp9": NO_H264, "gif": "delete window.VideoEncoder"}
"""Codecs by what a page must do without."""


@pytest.mark.parametrize("codec", ["h264", *(pytest.param(c, marks=pytest.mark.sweep) for c in ("vp9", "gif"))])
def test_a_film_to_share_is_a_video_or_else_a_gif_and_ends_in_place(
    visit: Any, folders: dict[str, Path], tmp_path: Path, codec: str
) -> None:
    tab = visit()
    tab.evaluate(f"() => {{ {FILM_KINDS[codec]} }}")
    with tab.expect_download(timeout=90_000) as download:
        tab.get_by_role("button", name="Film to share").click()
    assert download.value.suggested_filename == f"magic-lens.{'gif' if codec == 'gif' else 'mp4'}"
    film = tmp_path / download.value.suggested_filename
    download.value.save_as(film)
    with av.open(film) as opened:
        stream = opened.streams.video[0]
        assert stream.codec_context.name == codec
        assert float(stream.duration * stream.time_base) == pytest.approx(5, abs=0.1)
    first, *_, last = read_frames(film)
    assert first.shape[:2] == (480, 480)
    middle = (slice(180, 300), slice(180, 300))  # within the lens, once it lies there
    assert psnr_db(blurred(last)[middle], blurred(first)[middle]) < 25
    # at the end the last view is in place
    place = 480 / (2.2 * sheet_share(tab))
    (seen,) = captured(tab, 1, [{}])
    side = round(place)
    turns = open_run(folders["rotating"]).scene.views[1].quarter_turns
    wanted = blurred(resize(np.ascontiguousarray(np.rot90(seen, turns)), (side, side)))
    at = round(240 - side / 2)
    inner = (slice(at + 20, at + side - 20),) * 2
    assert psnr_db(blurred(last)[inner], wanted[20:-20, 20:-20]) > 20


def sheet_share(tab: Page) -> float:
    """Half the side of the sheet in sides of the lens, as the viewer shows it."""
    script = "JSON.parse(document.querySelector('[data-part=data]').textContent).lens"
    lens = tab.evaluate(script)
    return min(max(lens["source_size"] / lens["size"] / 2, 0.5), 0.7)


def blurred(picture_: FloatArray) -> FloatArray:
    return np.asarray(gaussian_filter(to_display(picture_).mean(axis=-1), 3))


def test_with_a_projector_nothing_is_shown_but_the_table_and_page_keys_lead_through_all_views(visit: Any) -> None:
    tab = visit(width=1024, height=768)
    tab.get_by_role("button", name="Projector").click()
    tab.evaluate("magiclens.settled()")
    stage = tab.locator("[data-part=stage]").bounding_box()
    assert stage == {"x": 0, "y": 0, "width": 1024, "height": 768}
    assert not tab.get_by_role("button", name="Put it in place").is_visible()
    assert canvas(tab)[5, 5].mean() < 100, "light around the picture takes contrast from it"
    for view in (0, 1):
        tab.keyboard.press("PageDown")
        assert tab.evaluate("[magiclens.view(), magiclens.atHome()]") == [view, True]
    tab.keyboard.press("PageDown")
    assert tab.evaluate("[magiclens.view(), magiclens.atHome()]") == [0, False]
    assert [rule["id"] for rule in Axe().run(tab).response["violations"]] == []
    tab.keyboard.press("Escape")
    assert tab.get_by_role("button", name="Put it in place").is_visible()
    assert tab.evaluate("document.activeElement.dataset.part") == "project"
