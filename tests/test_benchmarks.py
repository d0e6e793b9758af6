"""The benchmarks: results are compared before times are, and what is compared does the same work."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from magiclens.contract.artifacts import FloatArray

ROOT = Path(__file__).parent.parent


@pytest.fixture
def comparison(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return module("comparison", monkeypatch)


def module(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    from importlib import import_module

    monkeypatch.syspath_prepend(ROOT)
    return import_module(f"benchmarks.{name}")


def test_all_take_turns_and_the_median_counts(comparison: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Our runs take 1, 9 and 2 seconds of a clock that only work moves, the peer's ten times as long."""
    now, calls = 0.0, []

    def work(name: str, seconds: list[float]) -> str:
        nonlocal now
        calls.append(name)
        now += seconds[sum(call == name for call in calls) - 1]
        return "result"

    monkeypatch.setattr(comparison, "perf_counter", lambda: now)
    ours, peer = (lambda: work("ours", [50, 1, 9, 2])), (lambda: work("peer", [50, 10, 90, 20]))
    case = comparison.Comparison("topic", "task", ours, {"peer": peer}, lambda a, b: f"{a} {b}")
    (ratio,) = comparison.measure(case, 3)
    assert calls == ["ours", "peer", "ours", "peer", "peer", "ours", "ours", "peer"]
    assert (ratio.ours_s, ratio.peer_s, ratio.times, ratio.agreement) == (2, 20, 10, "result result")
    assert "| topic | task | peer | 2 s | 20 s | **10** | result result |" in comparison.table([ratio])


def test_what_takes_long_is_done_once(comparison: ModuleType) -> None:
    calls: list[str] = []
    ours, peer = (lambda: calls.append("ours")), (lambda: calls.append("peer"))
    case = comparison.Comparison("topic", "task", ours, {"peer": peer}, lambda a, b: "", once=True)
    (ratio,) = comparison.measure(case, 3)
    assert calls == ["ours", "peer"]
    assert min(ratio.ours_s, ratio.peer_s) > 0


def test_nothing_is_timed_where_results_differ(comparison: ModuleType) -> None:
    case = comparison.Comparison(
        "topic", "task", lambda: 1.0, {"peer": lambda: 1.1},
        lambda a, b: comparison.require(abs(a - b) < 0.05, "sums"),
    )  # fmt: skip
    with pytest.raises(comparison.Disagreement, match="results differ: sums"):
        comparison.measure(case, 1)


def test_a_ratio_that_fell_since_it_was_kept_is_a_loss(
    comparison: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    history, path = module("history", monkeypatch), tmp_path / "history.csv"

    def ratio(times: float, task: str = "task") -> Any:
        return comparison.Ratio("topic", task, "peer", 1.0, times, "equal")

    history.keep([ratio(9.0)], "early", path)
    history.keep([ratio(4.0), ratio(2.0, "other")], "late", path)
    assert history.losses([ratio(3.2), ratio(7.0, "other")], path) == []
    assert history.losses([ratio(3.0), ratio(2.0, "other")], path) == ["topic, task, peer: 3, but 4 at late"]
    with pytest.raises(LookupError, match="no ratio of topic, new, peer"):
        history.losses([ratio(3.0, "new")], path)


def test_the_page_keeps_all_but_its_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    main = module("__main__", monkeypatch)
    page = tmp_path / "page.md"
    page.write_text(f"before\n{main.BEGIN}old\n{main.END}after\n", encoding="utf-8")
    main.write("new\n", page)
    assert page.read_text(encoding="utf-8") == f"before\n{main.BEGIN}new\n{main.END}after\n"
    assert main.BEGIN in main.PAGE.read_text(encoding="utf-8")


def test_our_search_and_opencv_find_the_least_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    matching = module("matching", monkeypatch)
    source, target = matching.mosaic(8 * 3 + 99, (0, 1, 2, 3)), matching.mosaic(8 * 3, (2, 3, 1, 0))
    patches = np.lib.stride_tricks.sliding_window_view(source, (8, 8), (0, 1)).transpose(0, 1, 3, 4, 2)
    tile = target[8:16, :8]  # the fourth: second row, first column
    sums = ((patches[8:108, :100] - tile) ** 2).sum(axis=(2, 3, 4))
    edges = [*matching.parts(), 100]
    least = [sums[a:b, c:d].min() for a, b in zip(edges, edges[1:]) for c, d in zip(edges, edges[1:])]  # noqa: B905, RUF007
    for find in (matching.search_window, matching.opencv):
        np.testing.assert_allclose(find(source, target)[3], least, rtol=1e-3, atol=1e-3)


def test_our_solver_and_a_direct_one_leave_the_same_residual(
    comparison: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    integration = module("integration", monkeypatch)
    case = integration._comparison(("SciPy spsolve",), 24, 1.0)
    ours, theirs = case.ours(), case.peers["SciPy spsolve"]()
    assert case.agreement(ours, theirs).startswith("residual")
    np.testing.assert_allclose(ours.ravel(), theirs, atol=1e-3 * np.abs(theirs).max())
    wrong: FloatArray = 1.01 * ours
    with pytest.raises(comparison.Disagreement):
        case.agreement(wrong, theirs)


@pytest.mark.tools
def test_every_comparison_works_at_a_small_size() -> None:
    command = [sys.executable, "-m", "benchmarks", "--quick", "--repeats", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for topic in ("tracing", "matching", "annealing", "integration", "refinement", "slicing"):
        assert f"\n| {topic} |" in done.stdout


def test_a_topic_that_is_not_there_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    main = module("__main__", monkeypatch)
    monkeypatch.setattr(sys, "argv", ["benchmarks", "tracking"])
    with pytest.raises(SystemExit) as left:
        main.main()
    assert left.value.code == 2
    assert "no such topic: tracking; there are tracing" in capsys.readouterr().err
