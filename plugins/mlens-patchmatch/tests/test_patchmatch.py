"""Guessing is nearly as good as looking everywhere, and takes as long in a large window as in a small one."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np
import pytest
from mlens_patchmatch.matcher import PatchMatch
from mlens_patchmatch.search import search

from magiclens import InputError, Run, load_plan, run_spec, silent
from magiclens.testing import MatcherContract, two_eyes

SPEC = """\
scenario: %s
lens: {size: 30mm, facets: 8, microfacets: 12, thickness: 30mm}
pipeline:
  matcher: {type: patchmatch, window: 50%%}
  exporters: []
  renderers: [{type: tracer, resolution: 256}]
report: {analyses: [ideal-picture]}
"""
SINGLE = "{type: single, source: {type: circles, seed: 7}, target: {art: panda}}"
ROTATING = "{type: rotating, source: {type: circles, seed: 7}, targets: [{art: panda}, {art: bat}]}"


class TestPatchMatch(MatcherContract):
    stage = PatchMatch(window="15%", guesses=100)


def written(folder: Path, scenario: str) -> Path:
    path = folder / "lens.yaml"
    path.write_text(SPEC % scenario, encoding="utf-8")
    return path


def mean_db(run: Run) -> float:
    return float(np.mean([view["psnr_db"] for view in run.manifest["views"]]))


@pytest.mark.parametrize("scenario", [SINGLE, ROTATING])
def test_matching_and_the_traced_picture_are_within_half_a_decibel_of_exact(scenario: str, tmp_path: Path) -> None:
    """On average of some seeds: of so few facets, each with another patch, pictures differ by half a decibel."""
    spec, runs = written(tmp_path, scenario), {}
    for matcher in ("patchmatch", "exhaustive"):
        for seed in range(3):
            overrides = [f"pipeline.matcher.type={matcher}", f"seed={seed}"]
            runs[matcher, seed] = run_spec(spec, tmp_path / f"{matcher}-{seed}", overrides)
    for measure in (mean_db, lambda run: run.manifest["metrics"]["matching_psnr_db"]):
        mine, exact = (
            np.mean([measure(runs[matcher, seed]) for seed in range(3)]) for matcher in ("patchmatch", "exhaustive")
        )
        assert mine > exact - 0.5


def test_a_window_of_25_times_the_area_hardly_takes_longer(tmp_path: Path) -> None:
    scene = load_plan(written(tmp_path, SINGLE)).scene()
    taken = {}
    for window in ("10%", "10%", "50%"):  # the first compiles
        began = process_time()
        search(PatchMatch(window=window), scene, np.random.default_rng(0), silent)
        taken[window] = process_time() - began
    assert taken["50%"] < 1.5 * taken["10%"]


def test_several_eyes_are_refused_with_the_matcher_that_takes_them() -> None:
    with pytest.raises(InputError, match=r"share one eye; 'multi-view'"):
        PatchMatch().match(two_eyes(), np.random.default_rng(0))


def test_options_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    overrides = ["pipeline.matcher={type: patchmatch, smallest: 0.5, largest: 0.2}"]
    with pytest.raises(InputError, match=r"smallest is 0.5 and largest 0.2; exchange them"):
        load_plan(written(tmp_path, SINGLE), overrides)
