"""Measures how much faster two workers are than one, and compares what they make.

`sweep`: a sweep of lenses that mostly match, from the start of the cluster to its end. `lens`: matching and refinement
of one lens, on workers that have loaded what they need. Workers have one thread each. Run it on an idle machine with
two cores or more. Exit code 1: the gain is below the bar, or some bytes differ.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

from mlens_dask.executor import Dask

from magiclens import load_plan, run_plan, spreading_by
from magiclens.running.observers import Observer

_BARS = {"sweep": 1.7, "lens": 1.8}
"""How many times as fast two workers must be."""
_SCENARIO = """\
scenario:
  type: rotating
  source: {type: circles, seed: 7, size: 60mm}
  targets: [{art: panda}, {art: bat}, {art: heart}, {art: star}]
  angles: [0deg, 90deg, 180deg, 270deg]
report: {analyses: []}
"""
_SWEPT = """\
lens: {size: 60mm, facets: 24, microfacets: 8, relief: 8mm}
pipeline:
  matcher: {type: exhaustive, window: 20%, scales: [0.1, 0.2, 0.3, 0.5, 0.8]}
"""
_ONE = "lens: {size: 60mm, facets: 64, microfacets: 22, relief: 8mm}"
_SMALL = ["lens.facets=8"]


def main() -> int:
    """Time what is asked for with one worker, then with two."""
    os.environ["MLENS_CACHE_SIZE"] = "0"  # or the second time, lenses would be those of the first
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("what", nargs="*", help="sweep, lens; both by default")
    options.add_argument("--runs", type=int, default=8, help="lenses in the sweep")
    chosen = options.parse_args()
    failed = False
    for what in chosen.what or _BARS:
        with tempfile.TemporaryDirectory() as scratch:
            work = Path(scratch)
            seconds = _time_sweep(work, chosen.runs) if what == "sweep" else _time_lens(work)
            same = _contents(work / "by-1") == _contents(work / "by-2")
        ratio = seconds[1] / seconds[2]
        print(f"{what}: 1 worker {seconds[1]:.1f} s, 2 workers {seconds[2]:.1f} s, {ratio:.2f} times as fast")
        print(f"load of the machine {os.getloadavg()[0]:.1f}; equal bytes: {'yes' if same else 'no'}", flush=True)
        failed |= not same or ratio < _BARS[what]
    return int(failed)


def _time_sweep(work: Path, runs: int) -> dict[int, float]:
    """Seconds that a sweep takes, by the number of workers."""
    from magiclens.sweep.sweeping import sweep_spec

    (work / "sweep.yaml").write_text(_SCENARIO + _SWEPT, encoding="utf-8")
    seconds = {}
    for name, workers, lenses in (("warm", 1, 1), ("by-1", 1, runs), ("by-2", 2, runs)):
        began = time.perf_counter()
        seeds = ",".join(map(str, range(lenses)))
        done = sweep_spec(work / "sweep.yaml", [f"seed={seeds}"], work / name, Dask(workers=workers))
        if done.failed:
            sys.exit(next(result.error for result in done.results if result.error))
        seconds[workers] = time.perf_counter() - began
    manifests = [json.loads(path.read_text(encoding="utf-8")) for path in (work / "by-1").glob("*/manifest.json")]
    matching = sum(stage["seconds"] for m in manifests for stage in m["stages"] if stage["kind"] == "matcher")
    print(f"{runs} lenses; matching takes {100 * matching / sum(m['seconds'] for m in manifests):.0f} % of their runs")
    return seconds


def _time_lens(work: Path) -> dict[int, float]:
    """Seconds that matching and refinement of one lens take, by the number of workers."""
    (work / "lens.yaml").write_text(_SCENARIO + _ONE, encoding="utf-8")
    seconds = {}
    for workers in (1, 2):
        with Dask(workers=workers).spreader() as spreader, spreading_by(spreader):
            run_plan(load_plan(work / "lens.yaml", _SMALL), work / "warm" / "lens")
            watch = _Stopwatch()
            began = time.perf_counter()
            run_plan(load_plan(work / "lens.yaml"), work / f"by-{workers}" / "lens", watch)
            whole = time.perf_counter() - began
        parts = {name: watch.seconds[name] for name in ("matcher exhaustive", "integrator poisson, refinement")}
        texts = ", ".join(f"{name} {taken:.1f} s" for name, taken in parts.items())
        print(f"one lens, {workers} workers: {texts}; the whole run {whole:.1f} s", flush=True)
        seconds[workers] = sum(parts.values())
    return seconds


class _Stopwatch(Observer):
    """Keeps how long each piece of work has taken."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def finished(self, name: str, seconds: float) -> None:
        """Keep it."""
        self.seconds[name] = seconds


def _contents(out: Path) -> list[object]:
    """Names and hashes of all files but the manifests, which hold times."""
    return [json.loads(path.read_text(encoding="utf-8"))["artifacts"] for path in sorted(out.glob("*/manifest.json"))]


if __name__ == "__main__":
    sys.exit(main())
