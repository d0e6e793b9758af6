"""How many pictures a second the viewer shows while a lens is dragged, drawn in software, and when it is sharp again.

    python benchmarks/viewer_pace.py out/rotating out/fine-detail

The page of each run is opened in Chromium without a GPU, 1440 pixels wide, and the lens is dragged about over its sheet
for some seconds. A slow machine shows fewer pixels meanwhile: the table says how many. It also says how many processors
the browser got, since on a machine that is not quiet the figures are only lower bounds. Linux only.
"""

from __future__ import annotations

import math
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import Browser, Page

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from browsers import chromium
from magiclens.web.viewer.page import write_view

_LENS_MM = "JSON.parse(document.querySelector('[data-part=data]').textContent).lens.size"
_SIZE = {"width": 1440, "height": 1000}
_SECONDS = 5.0
_LEAST_RATE, _MOST_REST_S = 10.0, 2.0
"""What the viewer is to reach on two quiet cores."""
_WIDTH = "document.querySelector('.mlens canvas').width"


def main(runs: list[str]) -> int:
    """Measure the viewers of finished runs and print a table; 1 if one is slower than it should be."""
    print("| run | pictures a second | of the pixels along a side | sharp after | processors | load |")
    print("|---|---|---|---|---|---|")
    missed = False
    with TemporaryDirectory() as folder, chromium() as browser:
        for run in runs:
            page = write_view(Path(run), Path(folder) / "view.html")
            rate, share, rest_s, processors = _measured(browser, page)
            figures = f"{rate:.1f} | {share:.0%} | {rest_s:.1f} s | {processors:.2f} | {os.getloadavg()[0]:.1f}"
            print(f"| {Path(run).name} | {figures} |", flush=True)
            missed |= rate < _LEAST_RATE or rest_s > _MOST_REST_S
    return int(missed)


def _measured(browser: Browser, page: Path) -> tuple[float, float, float, float]:
    """Pictures a second while dragging, least share of the pixels along a side, seconds until all are there.

    The last number is how many processors the browser had while the lens was dragged.
    """
    tab = browser.new_page(viewport=_SIZE, reduced_motion="reduce")
    tab.goto(page.as_uri())
    tab.evaluate("magiclens.ready")
    tab.evaluate("magiclens.settled()")
    full, widths = tab.evaluate(_WIDTH), []
    _take(tab)
    place, before, used, began = tab.evaluate("magiclens.square()"), _pictures(tab), _processor_s(), time.monotonic()
    while (now := time.monotonic() - began) < _SECONDS:
        tab.mouse.move(place["x"] + 0.3 * place["width"] * (1 + math.sin(4 * now)), place["y"] + 80 * math.cos(3 * now))
        tab.wait_for_timeout(15)
        widths.append(tab.evaluate(_WIDTH))
    passed = time.monotonic() - began
    rate, processors = (_pictures(tab) - before) / passed, (_processor_s() - used) / passed
    tab.mouse.up()
    began = time.monotonic()
    tab.wait_for_function("magiclens.progress().sharp", polling=20)
    rest_s = time.monotonic() - began
    tab.close()
    return rate, min(widths) / full, rest_s, processors


def _processor_s() -> float:
    """Processor time of everything that this process has started, the browser's processes above all."""
    times, parents = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended
        pid = int(stat.parent.name)
        parents[pid], times[pid] = int(words[1]), int(words[11]) + int(words[12])
    ours = {os.getpid()}
    while found := {pid for pid, parent in parents.items() if parent in ours} - ours:
        ours |= found
    return sum(times[pid] for pid in ours - {os.getpid()}) / os.sysconf("SC_CLK_TCK")


def _take(tab: Page) -> None:
    """Press the button of the mouse on the lens."""
    place, pose, side = tab.evaluate(f"[magiclens.square(), magiclens.pose(), {_LENS_MM}]")
    per_mm = place["width"] / side
    middle = (place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    tab.mouse.move(middle[0] + pose["x"] * per_mm, middle[1] - pose["y"] * per_mm)
    tab.mouse.down()


def _pictures(tab: Page) -> int:
    return int(tab.evaluate("magiclens.progress().pictures"))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
