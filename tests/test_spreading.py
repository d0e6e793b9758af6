"""Loops that an executor may spread over other machines: in order, each item once, and the same lens."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from magiclens import run_spec
from magiclens.cli import app
from magiclens.contract.artifacts import Scene
from magiclens.kernels.resuming import going_through_loops_by
from magiclens.kernels.spreading import shares, spread, spreading_by
from magiclens.matching.exhaustive import Exhaustive
from magiclens.matching.multi_view import MultiViewMatcher
from magiclens.plan.compile import load_plan
from toys import Others

SPEC = """\
scenario: {type: single, source: {type: circles, seed: 7, size: 12mm}, target: {art: heart}}
lens: {size: 12mm, facets: 5, microfacets: 4, thickness: 15mm, relief: 4mm}
"""


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(SPEC, encoding="utf-8")
    return path


@pytest.fixture
def scene(spec: Path) -> Scene:
    return load_plan(spec).scene()


def raised(factor: int, item: int) -> int:
    return factor * item


def test_without_an_executor_it_is_an_ordinary_loop() -> None:
    begun: list[int] = []
    results = spread(lambda _, item: begun.append(item), None, [1, 2])
    next(results)
    assert begun == [1]
    assert shares(7) == [range(7)]


def test_other_machines_are_given_all_items_at_once() -> None:
    others = Others(2)
    with spreading_by(others):
        assert list(spread(raised, 10, [1, 2, 3])) == [(0, 10), (1, 20), (2, 30)]
    assert others.items == [1, 2, 3]
    assert list(spread(raised, 10, [4])) == [(0, 40)]
    assert others.items == [1, 2, 3]


def test_what_was_done_before_a_kill_is_not_spread_again() -> None:
    others, state = Others(2), np.zeros(3)
    with spreading_by(others), going_through_loops_by(lambda count, _: iter(range(1, count))):
        assert list(spread(raised, 10, [1, 2, 3], state)) == [(1, 20), (2, 30)]
    assert others.items == [2, 3]


@pytest.mark.parametrize(
    ("count", "workers", "finer", "most", "sizes"),
    [
        (7, 2, 1, None, [4, 3]),
        (10, 3, 1, None, [4, 3, 3]),
        (7, 2, 2, None, [2, 2, 2, 1]),
        (100, 2, 8, None, [25, 19, 14, 11, 8, 6, 6, 6, 5]),
        (100, 2, 8, 20, [20, 20, 15, 12, 9, 6, 6, 6, 6]),
        (2, 4, 1, None, [1, 1]),
        (0, 4, 1, None, []),
        (8, None, 4, None, [8]),
        (8, None, 4, 3, [3, 3, 2]),
        (8, 1, 1, 2, [2, 2, 2, 2]),
        (0, None, 1, 5, []),
    ],
)
def test_shares_cover_everything_and_the_smallest_come_last(
    count: int, workers: int | None, finer: int, most: int | None, sizes: list[int]
) -> None:
    with spreading_by(Others(workers) if workers else None):
        found = shares(count, finer, most)
    assert [len(share) for share in found] == sizes
    assert [index for share in found for index in share] == list(range(count))


@pytest.mark.parametrize("blocks", [1, 2, 3, 99])
def test_facets_that_others_match_get_the_same_candidates(scene: Scene, blocks: int) -> None:
    matcher, done = Exhaustive(window="10%", scales=(0.3, 0.8), candidates=9), list[float]()
    alone = matcher.match(scene, np.random.default_rng(0))
    others = Others(blocks)
    with spreading_by(others):
        found = matcher.match(scene, np.random.default_rng(0), done.append)
    assert len(others.items) == min(blocks, 5)
    assert done == sorted(done)
    assert done[-1] == 1
    for name in ("offsets_mm", "maps", "errors"):
        assert getattr(found, name).tobytes() == getattr(alone, name).tobytes()


EYES = """\
scenario:
  type: multi-view
  source: {type: circles, seed: 7, size: 20mm}
  views: [{target: {art: heart}, eye: {tilt: 9deg}}, {target: {art: star}, eye: {tilt: 9deg, azimuth: 180deg}}]
lens: {size: 12mm, facets: 5, microfacets: 4, thickness: 15mm, relief: 4mm}
pipeline:
  matcher: {type: multi-view, window: 10%, scales: [0.3, 0.8], candidates: 9}
  renderers: [{type: tracer, resolution: 64, samples: 2}]
report: {analyses: []}
"""


@pytest.mark.parametrize("blocks", [2, 99])
def test_facets_that_others_match_for_several_eyes_get_the_same_candidates(tmp_path: Path, blocks: int) -> None:
    (tmp_path / "eyes.yaml").write_text(EYES, encoding="utf-8")
    plan, others = load_plan(tmp_path / "eyes.yaml"), Others(blocks)
    matcher, heights = plan.matcher.stage, np.random.default_rng(1).random((5, 5))
    assert isinstance(matcher, MultiViewMatcher)
    alone = matcher.match_at(plan.scene(), heights)
    with spreading_by(others):
        found = matcher.match_at(plan.scene(), heights)
    assert len(others.items) == min(blocks, 5)
    for name in ("offsets_mm", "maps", "errors", "heights_mm"):
        assert getattr(found, name).tobytes() == getattr(alone, name).tobytes()


def test_a_run_whose_loops_others_do_has_the_same_files(tmp_path: Path) -> None:
    (tmp_path / "eyes.yaml").write_text(EYES, encoding="utf-8")
    others = Others(2)
    run_spec(tmp_path / "eyes.yaml", tmp_path / "alone")
    with spreading_by(others):
        run_spec(tmp_path / "eyes.yaml", tmp_path / "spread")
    assert others.functions >= {"_match_rows", "_picture_rows"}
    alone, spread_ = (
        json.loads((tmp_path / name / "manifest.json").read_text())["artifacts"] for name in ("alone", "spread")
    )
    assert alone == spread_


def test_an_executor_without_other_machines_is_refused_for_one_lens(spec: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["run", str(spec), "--executor", "processes", "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "error: --executor: 'processes' makes several lenses side by side, not one; leave it out" in done.stderr
