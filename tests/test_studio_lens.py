"""A real lens through the studio, from a picture to files, over a server that is killed in the middle."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
from PIL import Image, ImageDraw
from playwright.sync_api import Browser, Locator, Page, expect

from browsers import listen
from magiclens.cache.folder import SIZE_VARIABLE
from test_studio_browser import fits, serious

pytestmark = pytest.mark.tools

MLENS = (sys.executable, "-m", "magiclens")
PREVIEW_S = 60
"""From a picture to its first preview as printed, once kernels are compiled."""
PATIENCE_MS = 300_000
"""For each step: others may keep this machine busy."""
CLICKS = 8
"""From the start to both files."""
KEPT = {SIZE_VARIABLE: "1GB"}
"""The studio keeps results of stages, as at its users; in its own folder."""


class Served:
    """``mlens studio`` as a process, in one folder, again after it was killed."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.start()

    def start(self) -> None:
        words = ["studio", "--no-open", "--port", "0", "--folder", str(self.folder)]
        with self.folder.with_suffix(".txt").open("a") as errors:
            self.process = subprocess.Popen(
                [*MLENS, *words], stdout=subprocess.PIPE, stderr=errors, text=True, env=os.environ | KEPT
            )
        assert self.process.stdout
        found = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", self.process.stdout.readline())
        assert found
        self.address = found[0]

    def processor_seconds(self) -> float:
        """Of all runs that have ended, which bounds their time on quiet cores; others may keep this machine busy."""
        words = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[13]) + int(words[14])) / os.sysconf("SC_CLK_TCK")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(10)

    def stop(self) -> str:
        """What it complained about."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait(60)
        return self.folder.with_suffix(".txt").read_text()


@pytest.fixture(scope="module")
def served(compiled: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    studio = Served(tmp_path_factory.mktemp("lens") / "studio")
    yield studio
    assert studio.stop() == ""


class Visitor:
    """Somebody at a page of the studio, who counts clicks and remembers what the page complained about."""

    def __init__(self, browser: Browser, address: str, width: int, **options: Any):
        self.tab: Page = browser.new_page(viewport={"width": width, "height": 900}, **options)
        self.home, self.clicks = address.split("/?")[0], 0
        self.complaints = listen(self.tab, self.home)
        self.tab.goto(address)
        expect(self.tab.locator("#room")).to_contain_text("on the disk")

    def click(self, place: Locator) -> None:
        place.click()
        self.clicks += 1

    def pick(self, label: str, value: str) -> None:
        """Two clicks: one opens the list, one chooses."""
        self.tab.get_by_label(label).select_option(value)
        self.clicks += 2

    def download(self, job: Locator, title: str) -> bytes:
        with self.tab.expect_download() as download:
            self.click(job.get_by_role("link", name=title, exact=True).first)
        return Path(download.value.path()).read_bytes()

    def leave(self) -> None:
        assert fits(self.tab)
        assert serious(self.tab) == []
        assert self.complaints == []
        self.tab.close()


def photo() -> bytes:
    """A drawing as somebody might take it with a phone: a star, dark on light paper, not square."""
    image, out = Image.new("RGB", (500, 400), "#f3efe6"), io.BytesIO()
    ImageDraw.Draw(image).regular_polygon((250, 200, 150), 3, fill="#22262b")
    image.save(out, "JPEG", quality=90)
    return out.getvalue()


def drop(tab: Page, name: str, content: bytes) -> None:
    """Let a file fall on the page, as from the desktop."""
    tab.evaluate(
        """([name, bytes]) => {
            const data = new DataTransfer();
            data.items.add(new File([new Uint8Array(bytes)], name, { type: "image/jpeg" }));
            document.getElementById("drop").dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true }));
        }""",
        [name, list(content)],
    )


def order(visitor: Visitor) -> Locator:
    """The job of a draft that is done."""
    tab = visitor.tab
    drop(tab, "My star.jpg", photo())
    expect(tab.locator("#status")).to_have_text("my-star.png is added")
    visitor.pick("Your printer or mill", "sla")
    tab.get_by_label("Side of the lens").fill("25")
    visitor.clicks += 1  # on the slider
    expect(tab.locator("#preview canvas")).to_be_visible()
    expect(tab.locator("#preview[data-done]")).to_be_visible()
    visitor.click(tab.get_by_role("button", name="Design a draft", exact=True))
    job = tab.locator(".job").first
    expect(job.get_by_role("img", name="As the machine makes it")).to_be_visible(timeout=PATIENCE_MS)
    expect(job).to_contain_text("draft is done", timeout=PATIENCE_MS)
    expect(job).to_contain_text(re.compile("as made: (clear|recognisable|hard to see|lost)", re.IGNORECASE))
    expect(job).to_contain_text("A quick draft")
    return job


def files(visitor: Visitor, job: Locator) -> list[bytes]:
    expect(job).to_contain_text("full design is done", timeout=PATIENCE_MS)
    return [visitor.download(job, title) for title in ("Lens, 3MF", "Sheet to print, PDF")]


def test_from_a_photo_to_both_files_over_a_killed_server(browser: Browser, served: Served, tmp_path: Path) -> None:
    visitor = Visitor(browser, served.address, 1440, color_scheme="light")
    job = order(visitor)
    assert served.processor_seconds() < PREVIEW_S
    visitor.tab.screenshot(path=tmp_path / "draft.png", full_page=True)
    visitor.click(job.get_by_role("button", name="Make the full design"))
    # a step of the run is done; the last of these is shown for seconds, the others are soon over
    expect(job).to_contain_text(re.compile(r"(matcher|annealer|integrator) .*\d s"), timeout=PATIENCE_MS)
    other = Visitor(browser, served.address, 390)
    expect(other.tab.locator(".job")).to_contain_text("full design is being made")
    other.tab.reload()
    expect(other.tab.locator(".job")).to_contain_text("full design is being made")
    other.tab.close()
    served.kill()
    visitor.tab.close()
    served.start()

    clicks, visitor = visitor.clicks, Visitor(browser, served.address, 1440, color_scheme="light")
    job = visitor.tab.locator(".job").first
    mesh, sheet = files(visitor, job)
    assert clicks + visitor.clicks <= CLICKS
    visitor.tab.screenshot(path=tmp_path / "full.png", full_page=True)
    with ZipFile(io.BytesIO(visitor.download(job, "Spec with its pictures, ZIP"))) as packed:
        packed.extractall(tmp_path)
    address = job.get_by_role("link", name="Spec as YAML").get_attribute("href")
    assert (tmp_path / "spec.yaml").read_text() == visitor.tab.request.get(f"{visitor.home}{address}").text()
    words = ["run", "spec.yaml", "--out", "out", "--quiet", "--no-cache", "--set", "report.analyses=[]"]
    subprocess.run([*MLENS, *words], cwd=tmp_path, check=True)
    assert mesh == (tmp_path / "out" / "lens.3mf").read_bytes()
    assert sheet == (tmp_path / "out" / "lens.pdf").read_bytes()
    visitor.leave()


def test_the_same_on_a_phone_in_the_dark(browser: Browser, served: Served, tmp_path: Path) -> None:
    """The draft is made again, of what the first one has left in the cache; the files are those of the first job."""
    visitor = Visitor(browser, served.address, 390, color_scheme="dark", reduced_motion="reduce")
    many = visitor.tab.locator(".job").count()
    assert many, "the test before makes the full design"
    job = order(visitor)
    expect(visitor.tab.locator(".job")).to_have_count(many + 1)
    with visitor.tab.expect_popup() as opened:
        job.get_by_role("link", name="The viewer on a page of its own").first.click()
    opened.value.evaluate("magiclens.ready")
    assert opened.value.evaluate("magiclens.views") == ["single"]
    opened.value.close()
    job.get_by_text("Move the lens over its sheet").first.click()
    job.locator("iframe").first.scroll_into_view_if_needed()
    inside = job.locator("iframe").first.element_handle().content_frame()
    assert inside
    inside.wait_for_load_state()
    inside.evaluate("magiclens.ready")
    inside.get_by_role("radio", name="As designed").check(force=True)
    assert inside.evaluate("self.origin") == "null", "it has nothing to do with the studio's page"
    mesh, sheet = files(visitor, visitor.tab.locator(".job").last)
    assert visitor.clicks <= CLICKS - 1, "the full design would take one more"
    assert mesh[:2] == b"PK"
    assert sheet[:4] == b"%PDF"
    visitor.tab.screenshot(path=tmp_path / "phone.png", full_page=True)
    visitor.leave()
