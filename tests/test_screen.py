"""The page that shows sources on a screen: true to size, offline, by tap and by key."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect
from typer.testing import CliRunner

from browsers import listen
from lenses import Lenses
from magiclens import InputError
from magiclens.cli import app
from magiclens.exporting.monitor import resampled
from magiclens.images import read_image, to_display
from magiclens.web.screen import screen_page

PHONE, DESK = {"width": 390, "height": 844}, {"width": 1400, "height": 900}
Visit = Callable[..., Page]


@pytest.fixture(scope="module")
def folder(lenses: Lenses) -> Path:
    """Two sources: two pairs over one lens."""
    return lenses.shipped("multi-pair").folder


@pytest.fixture(scope="module")
def page(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("screen") / "show.html"
    done = CliRunner().invoke(app, ["show", str(folder), "--no-open", "-o", str(path)])
    assert done.exit_code == 0, done.output
    assert done.output.strip() == str(path)
    return path


def data_of(text: str) -> dict[str, Any]:
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


def test_the_page_has_every_source_and_asks_for_nothing(folder: Path, page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    data = data_of(text)
    assert [frame["name"] for frame in data["frames"]] == ["pair-0", "pair-1"]
    assert data["size"] == 25.0
    assert data["card"] == [53.98, 85.6]
    assert [frame["up"] for frame in data["frames"]] == [{"top": "this edge up"}] * 2
    assert not re.findall(r"(?:src|href)=\"(?!data:)", text)
    assert "default-src 'none'" in text
    assert data["frames"][0]["outlines"][0][2] > 12.5, "the lens's bottom is wider than its top"


def test_one_frame_is_chosen_by_its_source_or_its_view(folder: Path, lenses: Lenses) -> None:
    rotating = lenses.shipped("rotating").folder
    for run, name, source in ((folder, "pair-1", "pair-1"), (rotating, "rotation-090", "source")):
        assert [frame["name"] for frame in data_of(screen_page(run, name))["frames"]] == [source]
    with pytest.raises(InputError, match=r"unknown frame 'pair-2'.*pair-1"):
        screen_page(folder, "pair-2")


def test_a_lens_that_is_turned_has_an_edge_for_each_view(lenses: Lenses) -> None:
    [frame] = data_of(screen_page(lenses.shipped("rotating").folder))["frames"]
    assert list(frame["up"]) == ["top", "left"]
    assert "rotation-090" in frame["up"]["left"]


def test_the_page_in_a_run_folder_is_one_of_its_files(lenses: Lenses, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(lenses.shipped("multi-pair").folder, copy)
    assert CliRunner().invoke(app, ["show", str(copy), "pair-0", "--no-open"]).exit_code == 0
    listed = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))["artifacts"]
    assert "show.html" in [artifact["path"] for artifact in listed]


@pytest.fixture
def visit(browser: Browser, page: Path) -> Iterator[Visit]:
    """Opens the page on some screen; at the end it has complained of nothing and asked for nothing."""
    contexts, complaints = [], []

    def opened(size: dict[str, int], ratio: float = 1.0, per_mm: float | None = 4.0) -> Page:
        context = browser.new_context(viewport=size, device_scale_factor=ratio, offline=True)  # type: ignore[arg-type]
        contexts.append(context)
        tab = context.new_page()
        complaints.append(listen(tab, page.as_uri()))
        if per_mm:
            tab.add_init_script(f"localStorage.setItem('magiclens: dots per mm', '{per_mm * ratio}')")
        tab.goto(page.as_uri())
        tab.evaluate("magiclens.ready")
        return tab

    yield opened
    for context in contexts:
        context.close()
    assert complaints == [[]] * len(complaints)


def pixels(tab: Page) -> np.ndarray[Any, Any]:
    """(S, S) what the canvas holds."""
    side = tab.evaluate("document.querySelector('canvas').width")
    whole = f"getImageData(0, 0, {side}, {side})"
    read = f"[...document.querySelector('canvas').getContext('2d').{whole}.data]"
    return np.array(tab.evaluate(read)).reshape(side, side, 4)[..., 0]


@pytest.mark.parametrize(("size", "ratio"), [(DESK, 1.0), (PHONE, 3.0)])
def test_every_pixel_of_the_screen_is_the_mean_over_its_area(
    visit: Visit, folder: Path, size: dict[str, int], ratio: float
) -> None:
    tab = visit(size, ratio)
    side = round(25 * 4 * ratio)
    seen = pixels(tab)
    assert seen.shape == (side, side)
    wanted = to_display(resampled(read_image(folder / "sources" / "pair-0.png"), side, side))[..., 0] * 255
    assert np.abs(seen - wanted).max() <= 1.01
    box = tab.locator("canvas").bounding_box()
    assert box is not None
    assert box["width"] == pytest.approx(side / ratio, abs=0.01)
    assert box["x"] * ratio == pytest.approx(round(box["x"] * ratio), abs=0.01), "on whole pixels"


def test_a_card_sets_the_size_once_and_for_all(visit: Visit) -> None:
    tab = visit(PHONE, 2.0, None)
    assert tab.locator("#calibration").is_visible()
    tab.locator("#scale").fill("4.5")
    box = tab.locator("#card").bounding_box()
    assert box is not None
    assert (box["width"], box["height"]) == pytest.approx((53.98 * 4.5, 85.60 * 4.5), abs=0.02)
    tab.locator("#done").click()
    expect(tab.locator("canvas")).to_have_js_property("width", 225)
    assert "guess" not in tab.locator("#words").inner_text()
    assert tab.evaluate("localStorage.getItem('magiclens: dots per mm')") == "9"


def test_frames_go_by_key_by_button_and_by_tap(visit: Visit) -> None:
    tab = visit(DESK)
    words = tab.locator("#words")
    for act, name in (
        (lambda: tab.keyboard.press("ArrowRight"), "pair-1 (2 of 2)"),
        (lambda: tab.keyboard.press("ArrowRight"), "pair-0 (1 of 2)"),
        (lambda: tab.locator("#previous").click(), "pair-1"),
        (lambda: tab.locator("canvas").click(), "pair-0"),
    ):
        act()
        expect(words).to_contain_text(name)
    assert "Lay the lens on the outline" in words.inner_text()


def test_the_outline_is_where_the_lens_lies(visit: Visit, page: Path) -> None:
    tab = visit(DESK)
    west, _, east, north = data_of(page.read_text(encoding="utf-8"))["frames"][0]["outlines"][0]
    sheet, outline = (tab.locator(what).bounding_box() for what in ("canvas", ".outline"))
    assert sheet is not None
    assert outline is not None
    assert outline["width"] == pytest.approx(4 * (east - west), abs=0.1)
    assert outline["x"] - sheet["x"] == pytest.approx(4 * (12.5 + west), abs=0.6)
    assert outline["y"] - sheet["y"] == pytest.approx(4 * (12.5 - north), abs=0.6)
    assert tab.locator(".up").inner_text() == "▲ this edge up"
    tab.keyboard.press("o")
    assert tab.locator(".outline").count() == 0


def test_a_screen_that_is_too_small_says_so_and_full_screen_is_the_sheet_alone(visit: Visit) -> None:
    tab = visit(PHONE, 1.0, 20.0)
    assert "this screen shows only" in tab.locator("#words").inner_text()
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    tab = visit(DESK)
    tab.keyboard.press("f")
    expect(tab.locator(":fullscreen")).to_have_count(1)
    assert not tab.locator("#bar").is_visible()


def test_the_page_is_accessible(visit: Visit) -> None:
    for calibrated in (4.0, None):
        found = Axe().run(visit(PHONE, 1.0, calibrated))
        assert found.violations_count == 0, found.generate_report()
