"""Times magiclens next to what one would use instead, and prints one table of ratios.

    pip install -e '.[bench]'
    python -m benchmarks [TOPIC ...] [--quick | --thorough] [--repeats 5] [--write | --keep | --check]

Everything is timed in this process, on the same data, in turns, and a ratio is printed only if the results agree.
``--write`` also writes the table to ``docs/reference/performance.md``; ``--keep`` adds the ratios to
``benchmarks/history.csv``, and ``--check`` fails if one is much smaller than when it was kept last. Whole runs are
compared with an older commit of this repository: ``python -m benchmarks whole-run --against COMMIT``.
"""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks.comparison import Comparison, Ratio, measure, table
from benchmarks.history import keep, losses

TOPICS = ("tracing", "matching", "annealing", "integration", "refinement", "slicing", "whole-run")
PAGE = Path(__file__).parents[1] / "docs" / "reference" / "performance.md"
BEGIN, END = "<!-- what follows is written by python -m benchmarks --write -->\n", "<!-- end -->\n"
PEERS = ("opencv-python-headless", "mitsuba", "embreex", "faiss-cpu", "scipy", "cvxopt", "pyamg", "numba", "numpy")


def comparisons(topic: str, options: argparse.Namespace) -> list[Comparison]:
    """What there is to compare of a topic."""
    module = importlib.import_module(f"benchmarks.{topic.replace('-', '_')}")
    found: list[Comparison] = module.comparisons(options)
    return found


def surroundings() -> str:
    """On how many cores, and with which versions, it was measured."""
    found = []
    for name in PEERS:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} not installed")
    return f"Python {platform.python_version()}, {os.cpu_count()} cores, {', '.join(found)}."


def write(text: str, page: Path = PAGE, begin: str = BEGIN, end: str = END) -> None:
    """Put a text in the place of what the page said before between two lines."""
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    _, _, after = rest.partition(end)
    page.write_text(f"{before}{begin}{text}{end}{after}", encoding="utf-8")


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="How fast magiclens is, next to others.")
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help=f"of {', '.join(TOPICS)}; all by default")
    parser.add_argument("--quick", action="store_true", help="small sizes: whether it works, not how fast it is")
    parser.add_argument("--thorough", action="store_true", help="also what takes half an hour: a very long annealing")
    parser.add_argument("--repeats", type=int, default=3, help="timings of which the median counts")
    parser.add_argument("--against", metavar="COMMIT", help="the older commit with which whole runs are compared")
    parser.add_argument("--write", action="store_true", help="write the table to docs/reference/performance.md, too")
    parser.add_argument("--keep", action="store_true", help="add the ratios to benchmarks/history.csv")
    parser.add_argument("--check", action="store_true", help="fail if a ratio is much smaller than in that file")
    options = parser.parse_args()
    unknown = set(options.topics) - set(TOPICS)
    if unknown:
        parser.error(f"no such topic: {', '.join(sorted(unknown))}; there are {', '.join(TOPICS)}")
    ratios: list[Ratio] = []
    for topic in options.topics or TOPICS:
        for comparison in comparisons(topic, options):
            for peer in comparison.missing:
                print(f"{topic}: {peer} is not installed", flush=True)
            for ratio in measure(comparison, options.repeats):
                ratios.append(ratio)
                print(f"{topic}: {ratio.task}: {ratio.peer} takes {ratio.times:.3g} times as long", flush=True)
    text = table(ratios)
    print(f"\n{text}\n{surroundings()}")
    if options.write:
        write(f"\n{text}\n{surroundings()}\n\n")
    if options.keep:
        describe = ["git", "describe", "--always", "--dirty"]
        keep(ratios, subprocess.check_output(describe, cwd=PAGE.parent, text=True).strip())
    if options.check and (lost := losses(ratios)):
        sys.exit("\n".join(["slower than others by more than before:", *lost]))


if __name__ == "__main__":
    main()
