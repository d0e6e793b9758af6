"""From spec and registry to a plan: every option explicit, and the same plan again from what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from magiclens.config.fields import Inputs
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.describe import describe_plan
from magiclens.plan.registry import Registry
from toys import SpecWriter


@pytest.fixture
def plan(write_spec: SpecWriter, registry: Registry) -> Plan:
    return load_plan(write_spec(), registry=registry)


def test_units_are_gone_inside_a_plan(plan: Plan) -> None:
    assert (plan.lens.size_mm, plan.lens.source_size_mm, plan.lens.facets) == (20.0, 20.0, 4)
    assert plan.scenario.shots(plan.lens, plan.spec.viewer)[0].eye_mm.tolist() == [0, 0, 440]


def test_stages_know_the_plugin_they_come_from(plan: Plan) -> None:
    assert str(plan.matcher) == "matcher toy (magiclens-toys 1.2)"
    assert [step.name for step in plan.steps][-2:] == ["exporter toy", "renderer tracer"]


def test_every_option_is_explicit_in_a_resolved_spec(plan: Plan) -> None:
    resolved = plan.resolved()
    assert resolved["pipeline"]["matcher"] == {"type": "toy", "sweeps": 5, "window": "10%", "step": "0.5mm"}
    assert resolved["lens"]["wall"] == "0.0005mm"
    assert resolved["lens"]["material"] == "acrylic"
    assert "ior" not in resolved["lens"]
    assert resolved["scenario"]["source"]["radius"] == ["0.5mm", "2.5mm"]


def test_a_resolved_spec_gives_the_same_plan(plan: Plan, registry: Registry, tmp_path: Path) -> None:
    path = tmp_path / "again.yaml"
    YAML().dump(plan.resolved(), path)
    again = load_plan(path, registry=registry)
    assert again.resolved() == plan.resolved()
    assert (again.lens, again.scenario) == (plan.lens, plan.scenario)


def test_a_description_has_every_view_stage_and_option(plan: Plan) -> None:
    text = describe_plan(plan)
    for line in (
        "lens     20 mm, 4 x 4 facets of 5 mm, 2 x 2 micro-facets each, cells eye",
        "scenario rotating",
        "    source: {type: circles, seed: 7, radius: [0.5mm, 2.5mm], colours: black-and-white, layers: 4.0}",
        "  view rotation-090: eye (0, 0, 440) mm, rotation 90 deg, source circles (seed 7), target art bat",
        "  matcher toy (magiclens-toys 1.2), version 1",
        "    window: 10%",
        "  exporter toy (magiclens-toys 1.2), version 1",
    ):
        assert f"\n{line}\n" in f"\n{text}\n"


def test_a_plan_cannot_be_changed(plan: Plan) -> None:
    with pytest.raises(AttributeError):
        plan.lens = None  # type: ignore[misc,assignment]
    with pytest.raises(ValueError, match="frozen"):
        plan.matcher.stage.sweeps = 3  # type: ignore[attr-defined]


def test_the_source_may_be_larger_than_the_lens(write_spec: SpecWriter, registry: Registry) -> None:
    plan = load_plan(write_spec(("seed: 7", "seed: 7, size: 3cm")), registry=registry)
    assert (plan.lens.size_mm, plan.lens.source_size_mm) == (20.0, 30.0)


def test_a_plan_without_exporters_or_renderers_is_allowed(write_spec: SpecWriter, registry: Registry) -> None:
    plan = load_plan(write_spec(), ["pipeline.exporters=[]", "pipeline.renderers=[]"], registry)
    assert (plan.exporters, plan.renderers) == ((), ())


def test_files_of_equal_names_stay_apart_in_a_run_folder(tmp_path: Path) -> None:
    inputs = Inputs()
    paths = [tmp_path / "a" / "x.png", tmp_path / "b" / "x.png", tmp_path / "a" / "x.png", tmp_path / "y.png"]
    assert [inputs.portable(p) for p in paths] == ["inputs/x.png", "inputs/x-1.png", "inputs/x.png", "inputs/y.png"]


def test_paths_are_relative_to_the_spec(
    write_spec: SpecWriter, registry: Registry, grey_png: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir("/")
    plan: Any = load_plan(write_spec(("{art: bat}", "{image: grey.png}")), registry=registry)
    assert plan.scenario.targets[1].image == grey_png
    inputs = Inputs()
    assert plan.resolved(inputs)["scenario"]["targets"][1] == {"image": "inputs/grey.png"}
    assert list(inputs) == [grey_png]
