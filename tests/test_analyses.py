"""Analyses: which a run does, what becomes of their findings, and who is named when one fails."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from magiclens import Analysis, Findings, InputError, StageError, hookimpl
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.tiles import Tile
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.describe import describe_plan
from magiclens.plan.registry import Plugin, Registry
from magiclens.running.pipeline import Run, run_plan
from toys import SpecWriter

PLUGIN = Plugin("measures", "mlens-measures", "0.3")


def plugin_of(*analyses: object) -> object:
    """A plugin that contributes these analyses."""
    return SimpleNamespace(mlens_analyses=hookimpl(lambda: list(analyses), specname="mlens_analyses"))


def count_views(plan: Plan, result: RunResult) -> Findings:
    """The number of views, drawn as so many pixels."""
    views = len(result.scene.views)
    return Findings({"views": float(views)}, details=views, pictures={"dots": np.ones((1, views, 1), np.float32)})


def draw_views(result: RunResult, findings: Findings) -> list[Figure]:
    picture = np.zeros((20, 20 * findings.details, 3), np.uint8)
    return [Figure("view-count", "Views", [[Tile(picture, "", f"{result.manifest['metrics']['views']:g}")]], "Views.")]


VIEW_COUNT = Analysis("view-count", compute=count_views, figures=draw_views)
SLOW = Analysis("slow", applies=lambda plan: plan.lens.facets > 100)


@pytest.fixture
def measures(registry: Registry) -> Registry:
    """The toy stages, and a plugin with two analyses, one of which suits large lenses only."""
    registry.register(plugin_of(VIEW_COUNT, SLOW), PLUGIN)
    return registry


def run_of(write_spec: SpecWriter, registry: Registry, tmp_path: Path, *overrides: str) -> Run:
    return run_plan(load_plan(write_spec(), overrides, registry), tmp_path / "out")


def test_findings_become_metrics_pictures_and_figures(
    write_spec: SpecWriter, measures: Registry, tmp_path: Path
) -> None:
    run = run_of(write_spec, measures, tmp_path)
    assert run.manifest["metrics"]["views"] == 2
    with Image.open(run.folder / "figures" / "dots.png") as dots:
        assert dots.size == (2, 1)
    assert (run.folder / "figures" / "view-count.png").is_file()
    assert "Views." in (run.folder / "report.html").read_text(encoding="utf-8")


def test_a_plan_says_which_analyses_apply(write_spec: SpecWriter, measures: Registry) -> None:
    plan = load_plan(write_spec(), (), measures)
    assert [str(planned) for planned in plan.analyses] == ["analysis view-count (mlens-measures 0.3)"]
    assert describe_plan(plan).endswith("analyses: view-count")
    large = load_plan(write_spec(), ["lens.facets=101", "lens.microfacets=1"], measures)
    assert [planned.name for planned in large.analyses] == ["view-count", "slow"]


@pytest.mark.parametrize(("wanted", "done"), [("[]", False), ("[slow]", False), ("[slow, view-count]", True)])
def test_a_spec_chooses_its_analyses(
    wanted: str, done: bool, write_spec: SpecWriter, measures: Registry, tmp_path: Path
) -> None:
    run = run_of(write_spec, measures, tmp_path, f"report.analyses={wanted}")
    assert ("views" in run.manifest["metrics"]) == done
    assert (run.folder / "figures").exists() == done
    assert (run.folder / "report.html").is_file()


def test_an_unknown_analysis_is_an_error_with_its_place(write_spec: SpecWriter, measures: Registry) -> None:
    spec = write_spec(text="report:\n  analyses: [view-count, view-cuont]\n" + write_spec().read_text(encoding="utf-8"))
    with pytest.raises(InputError, match=r"toy\.yaml:2: report\.analyses\.1: unknown analysis.*'view-count'"):
        load_plan(spec, (), measures)


def test_an_analysis_that_two_plugins_claim_is_found_before_the_run(
    write_spec: SpecWriter, measures: Registry
) -> None:
    measures.register(plugin_of(SLOW), Plugin("other", "other-package", "2"))
    with pytest.raises(StageError, match="is claimed by"):
        load_plan(write_spec(), (), measures)


def test_a_failing_analysis_is_named(write_spec: SpecWriter, registry: Registry, tmp_path: Path) -> None:
    def fail(plan: Plan, result: RunResult) -> Findings:
        raise ZeroDivisionError("no light")

    registry.register(plugin_of(Analysis("brittle", compute=fail)), PLUGIN)
    complaint = r"analysis brittle \(mlens-measures 0\.3\) failed: ZeroDivisionError: no light"
    with pytest.raises(StageError, match=complaint):
        run_of(write_spec, registry, tmp_path)
    assert not (tmp_path / "out").exists()


def test_an_analysis_that_finds_something_else_is_named(
    write_spec: SpecWriter, registry: Registry, tmp_path: Path
) -> None:
    registry.register(plugin_of(Analysis("odd", compute=lambda plan, result: {"views": 1.0})), PLUGIN)  # type: ignore[arg-type,return-value]
    with pytest.raises(StageError, match=r"analysis odd .*it found a dict instead of Findings"):
        run_of(write_spec, registry, tmp_path)


def test_what_is_not_an_analysis_is_recorded(registry: Registry) -> None:
    registry.register(plugin_of(VIEW_COUNT, "not one", SimpleNamespace(name="half", compute=count_views)), PLUGIN)
    reasons = [failure.reason for failure in registry.failures]
    assert reasons == ["mlens_analyses: 'not one' has no name", "mlens_analyses: half lacks applies, figures"]
    assert registry.find("analysis", "view-count") is not None
