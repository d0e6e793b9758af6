"""Whole runs of ``specs/rotating.yaml``, as a user starts them, against an older commit of this repository."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from benchmarks.comparison import Comparison, require

_REPOSITORY = Path(__file__).parents[1]
_COLD = "cold kernels"
_LOSS_DB = 0.1
"""By how much views may be worse than with the older commit, on average: chance gives to one and takes from another."""


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """With the built-in tracer only, with Mitsuba, and with kernels that must be compiled first."""
    if options.against is None:
        print("whole-run: say --against COMMIT to compare with an older commit")
        return []
    scratch = Path(tempfile.mkdtemp(prefix="whole-run-"))
    old = scratch / "old"
    old.mkdir()
    packed = subprocess.run(
        ["git", "archive", options.against], cwd=_REPOSITORY, check=True, capture_output=True
    ).stdout
    subprocess.run(["tar", "-x", "-C", str(old)], input=packed, check=True)
    small = ["lens.facets=16", "lens.microfacets=8"] if options.quick else []
    tracer = [*small, "pipeline.renderers=[{type: tracer}]"]
    cases = {"tracer only": (tracer, ""), "with Mitsuba": (small, ""), f"tracer only, {_COLD}": (tracer, _COLD)}
    return [
        Comparison(
            "whole run", f"specs/rotating.yaml, {name}", partial(_run, _REPOSITORY, scratch / "new.out", *case),
            {f"commit {options.against[:7]}": partial(_run, old, scratch / "old.out", *case)}, _scores_agree,
        ) for name, case in cases.items()
    ]  # fmt: skip


def _run(repository: Path, out: Path, overrides: list[str], kernels: str) -> list[float]:
    """Run the spec in a process of its own, with the code of a working tree; returns the PSNR of each view, dB."""
    with tempfile.TemporaryDirectory() as empty:
        environment = {**os.environ, "PYTHONPATH": str(repository)}
        if kernels == _COLD:
            environment["NUMBA_CACHE_DIR"] = empty
        command = [sys.executable, "-m", "magiclens", "run", "specs/rotating.yaml", "--no-cache", "--out", str(out)]
        settings = [word for override in overrides for word in ("--set", override)]
        subprocess.run([*command, *settings], cwd=repository, env=environment, check=True, capture_output=True)
    views = json.loads((out / "manifest.json").read_text(encoding="utf-8"))["views"]
    return [view["psnr_db"] for view in views]


def _scores_agree(ours: list[float], theirs: list[float]) -> str:
    """Our lens may be better."""
    gains = [a - b for a, b in zip(ours, theirs, strict=True)]
    return require(sum(gains) / len(gains) > -_LOSS_DB, f"views show {min(gains):+.2f} to {max(gains):+.2f} dB more")
