"""What a lens costs by its number of facets: time and memory of whole runs, each in a process of its own.

    python -m benchmarks.scaling                        # 16 to 128 facets along a side; minutes
    python -m benchmarks.scaling --facets 256 512 --write

Prints a table; ``--write`` puts it into ``docs/reference/performance.md``, and charts into ``docs/images/scaling``.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from PIL import Image

from benchmarks.__main__ import PAGE, write
from magiclens.drawing.chart import Chart, ChartAxis, Curve

REPOSITORY = Path(__file__).parents[1]
BEGIN, END = "<!-- what follows is written by python -m benchmarks.scaling --write -->\n", "<!-- end of scaling -->\n"
SETTINGS = (
    "lens.microfacets=11", "pipeline.matcher={type: exhaustive, pixels: 4, candidates: 36}",
    "pipeline.renderers=[{type: tracer}]",
)  # fmt: skip
"""The lens of ``specs/single.yaml`` as one of so many facets is designed."""


@dataclass(frozen=True)
class Cost:
    """What a run with N x N facets took: seconds by the clock and of the processor, and memory at its peak, bytes."""

    facets: int
    wall_s: float
    processor_s: float
    peak_bytes: float


def measure(facets: int) -> Cost:
    """Run the spec in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        settings = [word for setting in (f"lens.facets={facets}", *SETTINGS) for word in ("--set", setting)]
        command = [sys.executable, "-m", "magiclens", "run", "specs/single.yaml", "--no-cache", "--quiet", *settings]
        began = perf_counter()
        child = subprocess.Popen([*command, "--out", str(Path(folder, "out"))], cwd=REPOSITORY)
        _, status, used = os.wait4(child.pid, 0)
        wall = perf_counter() - began
    if status:
        sys.exit(f"the run with {facets} x {facets} facets failed")
    return Cost(facets, wall, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024.0)


def table(costs: list[Cost]) -> str:
    """The costs as a table in Markdown."""
    lines = ["| facets | by the clock | per facet | processor | memory |", "|--:|--:|--:|--:|--:|"]
    for c in costs:
        times = f"{c.wall_s:.0f} s | {1000 * c.wall_s / c.facets**2:.1f} ms | {c.processor_s:.0f} s"
        lines.append(f"| {c.facets}² | {times} | {c.peak_bytes / 2**30:.2f} GiB |")
    return "\n".join(lines) + "\n"


class _Doublings(ChartAxis):
    """An axis of binary logarithms, with a tick at every doubling."""

    def ticks(self) -> dict[float, str]:
        """Powers of two by position."""
        powers = range(math.ceil(self.low), math.floor(self.high) + 1)
        return {(power - self.low) / (self.high - self.low): f"{2.0**power:g}" for power in powers}


def draw(costs: list[Cost]) -> None:
    """Draw time per facet, and memory, over the number of facets along a side."""
    n = np.log2([c.facets for c in costs])
    charts = {
        "time": ("Milliseconds by the clock per facet", [1000 * c.wall_s / c.facets**2 for c in costs]),
        "memory": ("Memory at the peak, GiB", [c.peak_bytes / 2**30 for c in costs]),
    }
    folder = PAGE.parents[1] / "images" / "scaling"
    folder.mkdir(exist_ok=True)
    for name, (axis, values) in charts.items():
        ys = np.log2(values)
        x = _Doublings("Facets along a side", float(n[0]) - 0.2, float(n[-1]) + 0.2)
        y = _Doublings(axis, float(ys.min()) - 0.4, float(ys.max()) + 0.4)
        chart = Chart(n, [Curve("11 x 11 micro-facets", ys, "#2b6cc4")], x, y, (x.low, x.low, ""))
        Image.fromarray(chart.draw()).save(folder / f"{name}.png", optimize=True)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description="Cost by the number of facets.")
    parser.add_argument("--facets", type=int, nargs="+", default=[16, 32, 64, 128], help="along a side, ascending")
    parser.add_argument("--write", action="store_true", help="write table and charts to the documentation, too")
    options = parser.parse_args()
    measure(4)  # compiles what is not compiled yet
    costs = []
    for facets in options.facets:
        costs.append(measure(facets))
        print(costs[-1], flush=True)
    text = table(costs)
    print(f"\n{text}")
    if options.write:
        write(f"\n{text}\n", begin=BEGIN, end=END)
        draw(costs)


if __name__ == "__main__":
    main()
