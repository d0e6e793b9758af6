"""Measures how much faster two workers are than one, in a sweep that mostly matches, and compares the files.

Run it on an idle machine with two cores or more. Exit code 1: the gain is below the bar, or some bytes differ.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mlens_dask.executor import Dask

_LEAST_GAIN = 1.7
_SPEC = """\
scenario:
  type: rotating
  source: {type: circles, seed: 7, size: 60mm}
  targets: [{art: panda}, {art: bat}, {art: heart}, {art: star}]
  angles: [0deg, 90deg, 180deg, 270deg]
lens: {size: 60mm, facets: 24, microfacets: 8, relief: 8mm}
pipeline:
  matcher: {type: exhaustive, window: 20%, scales: [0.1, 0.2, 0.3, 0.5, 0.8]}
"""


def main() -> int:
    """Time the sweep with one worker, then with two."""
    os.environ["MLENS_CACHE_SIZE"] = "0"  # or the second sweep would take its lenses from the first
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=8, help="lenses in the sweep")
    runs = options.parse_args().runs
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        (work / "sweep.yaml").write_text(_SPEC, encoding="utf-8")
        _swept(work, "warm", 1, 1)
        seconds = {workers: _swept(work, f"by-{workers}", workers, runs) for workers in (1, 2)}
        same = _contents(work / "by-1") == _contents(work / "by-2")
        share = _share_of_matching(work / "by-1")
    ratio = seconds[1] / seconds[2]
    print(f"{runs} lenses: 1 worker {seconds[1]:.1f} s, 2 workers {seconds[2]:.1f} s, {ratio:.2f} times as fast")
    print(f"matching takes {100 * share:.0f} % of the runs; load of the machine {os.getloadavg()[0]:.1f}")
    print(f"equal bytes: {'yes' if same else 'no'}")
    return 0 if same and ratio >= _LEAST_GAIN else 1


def _swept(work: Path, name: str, workers: int, runs: int) -> float:
    """Seconds that a sweep takes, from the start of the cluster to its end."""
    from magiclens.sweep.sweeping import sweep_spec

    began = time.perf_counter()
    seeds = ",".join(map(str, range(runs)))
    done = sweep_spec(work / "sweep.yaml", [f"seed={seeds}"], work / name, Dask(workers=workers))
    if done.failed:
        sys.exit(next(result.error for result in done.results if result.error))
    return time.perf_counter() - began


def _manifests(out: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*/manifest.json"))]


def _contents(out: Path) -> list[object]:
    """Names and hashes of all files but the manifests, which hold times."""
    return [manifest["artifacts"] for manifest in _manifests(out)]


def _share_of_matching(out: Path) -> float:
    """Share of the seconds of all runs that were spent in matching."""
    manifests = _manifests(out)
    matching = sum(stage["seconds"] for m in manifests for stage in m["stages"] if stage["kind"] == "matcher")
    return float(matching / sum(m["seconds"] for m in manifests))


if __name__ == "__main__":
    sys.exit(main())
