"""The studio as people use it: a real server, a real browser, a real run, from a picture to its files."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from browsers import listen
from test_studio import png

WIDTHS = [1440, 390]
RUN_MS = 900_000
"""A draft that compiles everything first, on a busy machine."""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where 'mlens studio' serves."""
    folder = tmp_path_factory.mktemp("studio")
    command = [sys.executable, "-m", "magiclens", "studio", "--no-open", "--port", "0", "--folder", str(folder)]
    own_cache = {key: value for key, value in os.environ.items() if key != "MLENS_CACHE_SIZE"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=own_cache)
    assert process.stdout
    found = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", process.stdout.readline())
    assert found
    yield found[0]
    process.send_signal(signal.SIGINT)
    assert process.wait(30) in (0, 128 + signal.SIGINT)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "star.png"
    path.write_bytes(png(5, 200))
    return path


def visit(browser: Browser, address: str, width: int, **options: Any) -> tuple[Page, list[str]]:
    tab = browser.new_page(viewport={"width": width, "height": 900}, reduced_motion="reduce", **options)
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


def test_from_a_picture_to_its_files_by_keyboard_alone(
    browser: Browser, address: str, picture: Path, tmp_path: Path
) -> None:
    tab, complaints = visit(browser, address, 1440)
    for _ in range(3):  # the skip from the page's start to the file button
        tab.keyboard.press("Tab")
        if tab.evaluate("document.activeElement.id") == "files":
            break
    with tab.expect_file_chooser() as chooser:
        tab.keyboard.press("Space")
    chooser.value.set_files(picture)
    expect(tab.locator("#status")).to_have_text("star.png is added")
    press_until(tab, "[name=scenario]")
    press_until(tab, "[name=machine]")
    tab.keyboard.type("sla")
    press_until(tab, "[name=size]")
    tab.keyboard.type("25")
    press_until(tab, "#design")
    tab.keyboard.press("Enter")
    job = tab.locator(".job").first
    expect(job.locator("progress, [data-key=cancel]").first).to_be_attached()
    expect(job).to_contain_text("draft is done", timeout=RUN_MS)
    expect(job.get_by_role("img", name="as designed")).to_be_visible()
    expect(job.get_by_role("img", name="as the machine makes it")).to_be_visible()
    expect(job).to_contain_text("Preflight:")
    assert tab.evaluate(
        "Promise.all([...document.images].map((i) => (i.loading = 'eager', i.decode()))).then(() => true)"
    )
    press_until(tab, "a[download][href$='.3mf']")
    with tab.expect_download() as download:
        tab.keyboard.press("Enter")
    download.value.save_as(tmp_path / "lens.3mf")
    assert (tmp_path / "lens.3mf").read_bytes()[:2] == b"PK"
    for name in ("Report", "Move the lens over its source"):
        with tab.context.expect_page() as opened:
            job.get_by_role("link", name=name).press("Enter")
        other = opened.value
        heard = listen(other, address.split("/?")[0])
        other.reload()
        other.wait_for_function("!window.magiclens || magiclens.ready.then(() => true)")
        assert other.title()
        assert not heard
        other.close()
    assert serious(tab) == []
    assert not complaints
    tab.reload()
    expect(tab.locator(".job").first).to_contain_text("draft is done")
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
    two = one.context.new_page()
    two.goto(address)
    one.set_input_files("#files", picture)
    expect(two.locator("#pictures")).to_contain_text("star.png")
    many = one.locator(".job").count()
    one.get_by_label("Side").select_option("40mm")
    one.get_by_role("button", name="Design a draft").click()
    expect(two.locator(".job")).to_have_count(many + 1)
    two.locator(".job").first.get_by_role("button", name="Cancel").click()
    expect(one.locator(".job").first).to_contain_text("cancelled", timeout=60_000)
    one.locator(".job").first.get_by_role("button", name="Delete").click()
    expect(two.locator(".job")).to_have_count(many)
    one.close()
    two.close()
