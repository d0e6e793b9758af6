"""The studio in a real browser: from a picture to a job, and from a job to its files."""

from __future__ import annotations

import io
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Browser, Page, Route, expect

from browsers import listen
from test_studio import png

WIDTHS = [1440, 390]
VERDICT = {"text": "as printed: clear", "status": "green"}
FINISHED = "0001-00000000"
"""A job that lies in the folder when the studio starts."""


def write_finished_job(folder: Path) -> None:
    run = folder / "full"
    (run / "figures").mkdir(parents=True)
    for name in ("target.png", "seen.png", "sheet.png", "figures/as-made-single.png"):
        (run / name).write_bytes(png(5))
    (run / "lens.3mf").write_bytes(b"PK a mesh")
    (run / "report.html").write_text("<!doctype html><title>Report</title><p>A report")
    view: dict[str, Any] = {"name": "single", "source": "sheet.png", "target": "target.png", "psnr_db": 21.5}
    view["renders"] = {"tracer": "seen.png"}
    artifacts = [{"path": "lens.3mf"}, {"path": "figures/as-made-single.png"}]
    metrics = {"tolerance_shift_x_mm": 0.4}
    manifest = {"views": [view], "artifacts": artifacts, "metrics": metrics, "scene": {"facets": 8}}
    (run / "manifest.json").write_text(json.dumps(manifest))
    checks = [{"check": "walls", "status": "amber", "text": "Some walls are high."}]
    (run / "preflight.json").write_text(json.dumps({"verdict": VERDICT, "status": "amber", "checks": checks}))
    state = {"title": "single: star", "state": "done", "want": "full", "said": "", "draft": []}
    (folder / "job.json").write_text(json.dumps(state))
    (folder / "spec.yaml").write_text("scenario: {}")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where 'mlens studio' serves; it ends without a complaint, with pages that still listen, too."""
    folder = tmp_path_factory.mktemp("studio")
    write_finished_job(folder / "jobs" / FINISHED)
    command = [sys.executable, "-m", "magiclens", "studio", "--no-open", "--port", "0", "--folder", str(folder)]
    said = folder.with_suffix(".txt")
    with said.open("w") as errors:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
    assert process.stdout
    found = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", process.stdout.readline())
    assert found
    yield found[0]
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    assert said.read_text() == ""


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "star.png"
    path.write_bytes(png(5, 200))
    return path


def visit(browser: Browser, address: str, width: int, **options: Any) -> tuple[Page, list[str]]:
    tab = browser.new_page(viewport={"width": width, "height": 900}, **{"reduced_motion": "reduce"} | options)
    complaints = listen(tab, address.split("/?")[0])
    tab.goto(address)
    expect(tab.locator("#room")).to_contain_text("on the disk")
    assert "token" not in tab.url
    return tab, complaints


def fits(tab: Page) -> bool:
    return bool(tab.evaluate("document.documentElement.scrollWidth <= innerWidth"))


def serious(tab: Page) -> list[str]:
    found = Axe().run(tab).response["violations"]
    return [
        f"{rule['id']}: {rule['nodes'][0]['html'][:120]}" for rule in found if rule["impact"] in ("serious", "critical")
    ]


def test_from_a_picture_to_a_job_by_keyboard_alone(browser: Browser, address: str, picture: Path) -> None:
    tab, complaints = visit(browser, address, 1440)
    # listened to from the start: Chromium may open a dialog before it learns that somebody waits for it
    tab.on("filechooser", lambda dialog: dialog.set_files(picture))
    press_until(tab, "#files")
    tab.keyboard.press("Space")
    expect(tab.locator("#status")).to_have_text("star.png is added")
    press_until(tab, "[name=machine]")
    tab.keyboard.type("resin printer with an 8")
    press_until(tab, "[name=size]")
    tab.keyboard.press("Home")
    tab.keyboard.press("ArrowRight")
    expect(tab.locator("#foreseen")).to_contain_text("after the draft")
    press_until(tab, "#design")
    many = tab.locator(".job").count()
    tab.keyboard.press("Enter")
    expect(tab.locator(".job")).to_have_count(many + 1)
    job = tab.locator(".job").first
    press_until(tab, "[data-key=cancel]")
    tab.keyboard.press("Enter")
    expect(job).to_contain_text("cancelled", timeout=60_000)
    identity = str(job.get_attribute("id")).removeprefix("job-")
    text = tab.request.get(f"{address.split('/?')[0]}/jobs/{identity}/spec.yaml").text()
    assert "lcd-8k" in text
    assert "size: 25mm" in text
    assert not complaints
    tab.close()


@pytest.mark.parametrize("width", WIDTHS)
def test_from_a_finished_job_to_its_files_by_keyboard_alone(
    browser: Browser, address: str, tmp_path: Path, width: int
) -> None:
    tab, complaints = visit(browser, address, width)
    job = tab.locator(f"#job-{FINISHED}")
    expect(job.get_by_role("img")).to_have_count(3)
    assert tab.evaluate(
        "Promise.all([...document.images].map((i) => (i.loading = 'eager', i.decode()))).then(() => true)"
    )
    for words in ("As the machine makes it", "As printed: clear.", "1 remark"):
        expect(job).to_contain_text(words)
    press_until(tab, "a[download][href$='.3mf']")
    with tab.expect_download() as download:
        tab.keyboard.press("Enter")
    download.value.save_as(tmp_path / "lens.3mf")
    assert (tmp_path / "lens.3mf").read_bytes() == b"PK a mesh"
    with tab.expect_popup() as opened:
        job.get_by_role("link", name="Report").press("Enter")
    expect(opened.value).to_have_title("Report")
    assert fits(tab)
    assert serious(tab) == []
    assert not complaints
    tab.close()


def press_until(tab: Page, selector: str) -> None:
    """Press Tab until what the selector names has the focus."""
    for _ in range(80):
        tab.keyboard.press("Tab")
        if tab.evaluate("(s) => document.activeElement.matches(s)", selector):
            return
    raise AssertionError(f"{selector} cannot be reached by keyboard")


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("colours", ["light", "dark"])
def test_the_page_fits_and_axe_finds_nothing(
    browser: Browser, address: str, picture: Path, width: int, colours: Any
) -> None:
    tab, complaints = visit(browser, address, width, color_scheme=colours)
    tab.set_input_files("#files", picture)
    expect(tab.locator("#status")).to_have_text("star.png is added")
    tab.get_by_role("button", name="Copy as YAML").click()
    expect(tab.locator("#yaml")).to_have_value(re.compile("type: single"))
    assert fits(tab)
    assert serious(tab) == []
    assert not complaints
    tab.close()


WATCHED = """
    const put = CanvasRenderingContext2D.prototype.putImageData, pictures = [];
    CanvasRenderingContext2D.prototype.putImageData = function (image, ...at) {
        pictures.push(image.data.slice());
        put.call(this, image, ...at);
    };
    const apart = (one, other) => one.reduce((sum, value, k) => sum + Math.abs(value - other[k]), 0) / one.length;
    const off = () => pictures.map((one) => apart(one, pictures.at(-1)));
    document.getElementById("preview").off = off;
"""
"""How far each picture that was drawn is from the last one."""


@pytest.mark.parametrize("motion", ["no-preference", "reduce"])
def test_the_guess_gets_better_tile_by_tile_unless_motion_is_unwelcome(
    browser: Browser, address: str, picture: Path, motion: Any
) -> None:
    tab, complaints = visit(browser, address, 1440, reduced_motion=motion)
    tab.evaluate(f"() => {{ {WATCHED} }}")
    tab.set_input_files("#files", picture)
    tab.get_by_label("Facets along a side").fill("96")
    expect(tab.locator("#preview")).to_contain_text("A guess, not a promise")
    expect(tab.locator("#preview img")).to_be_visible()
    expect(tab.locator("#preview[data-done='96']")).to_be_visible()
    off = tab.evaluate("document.getElementById('preview').off()")
    assert off == sorted(off, reverse=True)
    assert off[0] > 10, "it begins with the dots"
    assert len(off) == 2 if motion == "reduce" else len(off) > 4
    assert not complaints
    tab.close()


@pytest.mark.parametrize("status", [200, 400])
def test_an_answer_that_comes_late_changes_nothing(browser: Browser, address: str, picture: Path, status: int) -> None:
    """A forecast of the order before, or a refusal of it, arrives when the guess of the newer one is on the page."""
    tab, _ = visit(browser, address, 1440)
    waiting: list[Route] = []

    def delay_first(route: Route) -> None:
        if waiting:
            route.continue_()
        else:
            waiting.append(route)

    tab.locator("#files").set_input_files(picture)
    expect(tab.locator("#preview canvas")).to_be_visible()
    tab.route("**/api/forecasts", delay_first)
    tab.get_by_label("Side of the lens").fill("30")
    for _ in range(100):
        if waiting:
            break
        tab.wait_for_timeout(100)
    tab.get_by_label("Side of the lens").fill("40")
    expect(tab.locator("#foreseen")).to_contain_text("13 x 13, each")
    expect(tab.locator("#preview[data-done]")).to_be_visible()
    with tab.expect_response("**/api/forecasts"):
        if status == 200:
            waiting[0].continue_()
        else:
            waiting[0].fulfill(status=status, json={"errors": [{"where": None, "message": "too small"}]})
    tab.wait_for_timeout(500)
    expect(tab.locator("#preview canvas")).to_be_visible()
    expect(tab.locator("#foreseen")).to_contain_text("13 x 13, each")
    tab.close()


def test_cards_move_for_less_than_five_seconds_and_when_they_are_pointed_at(browser: Browser, address: str) -> None:
    """Longer motion needs a button that stops it (WCAG 2.2.2), and keeps a machine without a GPU busy."""
    tab = browser.new_page(viewport={"width": 1440, "height": 900}, reduced_motion="no-preference")
    tab.clock.install()
    tab.goto(address)
    moving = "document.getAnimations().filter((each) => each.playState === 'running').length"
    tab.locator(".cards.moving").wait_for()
    assert tab.evaluate(moving) > 5
    tab.clock.fast_forward(5000)
    assert tab.evaluate(moving) == 0
    tab.locator(".card").nth(1).hover()
    assert tab.evaluate(moving) > 0
    tab.close()


@pytest.fixture
def stripes(tmp_path: Path) -> Path:
    """A wide picture, 400 x 200: its 100 columns in the middle are black."""
    path, image = tmp_path / "stripes.png", Image.new("L", (400, 200), 255)
    image.paste(0, (150, 0, 250, 200))
    image.save(path)
    return path


def kept_picture(tab: Page, name: str) -> Image.Image:
    return Image.open(io.BytesIO(tab.request.get(tab.url + f"pictures/{name}").body())).convert("L")


def test_a_square_is_cut_out_by_keyboard_alone(browser: Browser, address: str, stripes: Path) -> None:
    tab, complaints = visit(browser, address, 1440)
    tab.locator("#files").set_input_files(stripes)
    tab.get_by_role("button", name="Crop stripes.png").press("Enter")
    press_until(tab, "[name=side]")
    tab.keyboard.press("Home")
    press_until(tab, "[name=across]")
    for _ in range(6):
        tab.keyboard.press("ArrowRight")
    assert not serious(tab)
    press_until(tab, "[value=cut]")
    tab.keyboard.press("Enter")
    expect(tab.locator("#status")).to_have_text("stripes-cropped.png is added")
    expect(tab.get_by_label("stripes-cropped.png (1)")).to_be_checked()
    expect(tab.get_by_label("stripes.png", exact=True)).not_to_be_checked()
    square = np.asarray(kept_picture(tab, "stripes-cropped.png"))
    # the middle square of 200 begins at 100; one of 64 there, moved by 6, has 20 of the black columns
    assert square.shape == (64, 64)
    assert (square[:, :44] == 255).all()
    assert (square[:, 44:] == 0).all()
    assert not complaints
    tab.close()


@pytest.mark.parametrize("width", WIDTHS)
def test_a_square_is_cut_out_by_dragging(browser: Browser, address: str, stripes: Path, width: int) -> None:
    tab, complaints = visit(browser, address, width)
    tab.locator("#files").set_input_files(stripes.rename(stripes.with_name(f"drag-{width}.png")))
    tab.get_by_role("button", name=f"Crop drag-{width}.png").click()
    box = tab.locator("#crop img").bounding_box()
    assert box
    pixel = box["width"] / 400

    def drag(start: tuple[int, int], end: tuple[int, int]) -> None:
        tab.mouse.move(box["x"] + start[0] * pixel, box["y"] + start[1] * pixel)
        tab.mouse.down()
        tab.mouse.move(box["x"] + end[0] * pixel, box["y"] + end[1] * pixel, steps=4)
        tab.mouse.up()

    assert fits(tab)
    drag((298, 198), (198, 98))  # by its corner: half the side
    drag((150, 50), (250, 70))  # the whole frame
    tab.get_by_role("button", name="Cut out").click()
    expect(tab.locator("#status")).to_have_text(f"drag-{width}-cropped.png is added")
    dark = (np.asarray(kept_picture(tab, f"drag-{width}-cropped.png")) < 128).all(axis=0)
    assert len(dark) == pytest.approx(100, abs=3)
    assert dark.sum() == pytest.approx(50, abs=3)
    assert dark[: dark.sum()].all()
    tab.get_by_role("button", name=f"Crop drag-{width}.png").click()
    tab.keyboard.press("Escape")
    expect(tab.locator("#crop")).to_be_hidden()
    expect(tab.locator("#pictures li").filter(has_text=f"drag-{width}")).to_have_count(2)
    assert not complaints
    tab.close()


def test_phones_offer_their_camera(browser: Browser, address: str, picture: Path) -> None:
    for phone in (True, False):
        tab, _ = visit(browser, address, 390, has_touch=phone, is_mobile=phone)
        assert tab.get_by_text("Take a photograph").is_visible() == phone
        if phone:
            tab.set_input_files("#camera", picture)
            expect(tab.locator("#status")).to_have_text("star.png is added")
            assert fits(tab)
        tab.close()


def test_mistakes_of_a_yaml_file_are_shown_with_their_lines_at_390_px(
    browser: Browser, address: str, tmp_path: Path
) -> None:
    (tmp_path / "mine.yaml").write_text(
        "scenario: {type: single, target: {art: bat}, source: {type: circles}}\nlens: {facetts: 3}\n"
    )
    tab, _ = visit(browser, address, 390)
    tab.set_input_files("#open", tmp_path / "mine.yaml")
    tab.get_by_role("button", name="Design a draft of this spec").click()
    expect(tab.get_by_role("alert")).to_contain_text("spec.yaml:2")
    expect(tab.get_by_role("alert")).to_contain_text("facets")
    assert fits(tab)
    tab.close()


def test_two_tabs_show_the_same_and_a_job_is_cancelled_and_deleted_in_one(
    browser: Browser, address: str, picture: Path
) -> None:
    one, _ = visit(browser, address, 1440)
    two, _ = visit(browser, address, 390)
    one.set_input_files("#files", picture)
    expect(two.locator("#pictures")).to_contain_text("star.png")
    many = one.locator(".job").count()
    one.get_by_label("Side of the lens").fill("40")
    one.get_by_role("button", name="Design a draft", exact=True).click()
    expect(two.locator(".job")).to_have_count(many + 1)
    two.locator(".job").first.get_by_role("button", name="Cancel").click()
    expect(one.locator(".job").first).to_contain_text("cancelled", timeout=60_000)
    one.locator(".job").first.get_by_role("button", name="Delete").click()
    expect(two.locator(".job")).to_have_count(many)
    one.close()
    two.close()
