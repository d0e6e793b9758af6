"""Ratios of earlier commits, kept in the repository, so that a loss is noticed when it happens."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

from benchmarks.comparison import Ratio

KEPT = Path(__file__).with_name("history.csv")
COLUMNS = ("commit", "topic", "work", "peer", "times")
MOST_LOSS = 1.3
"""How many times smaller than when it was kept last a ratio may be; machines differ, and none is quiet."""


def keep(ratios: Iterable[Ratio], commit: str, path: Path = KEPT) -> None:
    """Add ratios to the history, with the commit they were measured on."""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(COLUMNS)
        writer.writerows((commit, r.topic, r.task, r.peer, f"{r.times:.3g}") for r in ratios)


def losses(ratios: Iterable[Ratio], path: Path = KEPT) -> list[str]:
    """What is said about each ratio that is ``MOST_LOSS`` times smaller than it was, the last time it was kept.

    Raises LookupError if one was never kept: under another name nothing would ever be noticed.
    """
    with path.open(encoding="utf-8", newline="") as file:
        last = {(row["topic"], row["work"], row["peer"]): row for row in csv.DictReader(file)}
    found = []
    for ratio in ratios:
        key = (ratio.topic, ratio.task, ratio.peer)
        if key not in last:
            raise LookupError(f"{path.name} has no ratio of {', '.join(key)}: run again with --keep instead of --check")
        before = float(last[key]["times"])
        if ratio.times * MOST_LOSS < before:
            found.append(f"{', '.join(key)}: {ratio.times:.3g}, but {before:.3g} at {last[key]['commit']}")
    return found
