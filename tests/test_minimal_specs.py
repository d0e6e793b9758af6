"""Specs of nothing but a scenario, as people write them by hand, next to the shipped ones of the same pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from lenses import SPECS
from magiclens import load_plan
from magiclens.contract.errors import InputError
from magiclens.plan.compile import Plan

SCENARIOS = (
    "single", "rotating", "multi-pair", "multi-view", "stable-zone", "universal-animation", "question-answer-universal",
    "question-answer-source-optimized",
)  # fmt: skip


def minimal(name: str, folder: Path) -> Path:
    """The shipped spec with its scenario alone."""
    shipped = YAML(typ="safe").load(SPECS / f"{name}.yaml")
    path = folder / f"{name}.yaml"
    YAML().dump({"scenario": shipped["scenario"]}, path)
    return path


def design(plan: Plan) -> dict[str, Any]:
    """All of a plan that shapes the lens and decides on its score: all but other files and Mitsuba's pictures."""
    resolved = plan.resolved()
    pipeline = {key: value for key, value in resolved["pipeline"].items() if key != "exporters"}
    return resolved | {
        "pipeline": pipeline | {"renderers": [each for each in pipeline["renderers"] if each["type"] == "tracer"]}
    }


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_alone_is_the_same_lens(name: str, tmp_path: Path) -> None:
    assert design(load_plan(minimal(name, tmp_path))) == design(load_plan(SPECS / f"{name}.yaml"))


def test_facets_that_are_written_and_machines_go_first(tmp_path: Path) -> None:
    path = minimal("stable-zone", tmp_path)
    assert load_plan(path).lens.microfacets == 11
    few = load_plan(path, ["lens.facets=16"]).lens
    assert (few.facets, few.microfacets) == (16, 22)
    assert load_plan(path, ["fabrication.machine=sla"]).lens.facets == 32


@pytest.mark.parametrize(("material", "said"), [("acrylic", True), ("photopolymer-sla", False)])
def test_a_material_that_is_not_the_machines_is_said_aloud(material: str, said: bool, tmp_path: Path) -> None:
    path = minimal("single", tmp_path)
    notices = load_plan(path, ["fabrication.machine=sla", f"lens.material={material}"]).notices()
    assert any("usually makes lenses of photopolymer-sla" in notice for notice in notices) == said
    assert load_plan(path, ["fabrication.machine=sla"]).notices() == load_plan(path).notices()


def test_a_type_that_is_no_name_is_refused_with_a_machine_too(tmp_path: Path) -> None:
    settings = ["fabrication.machine=sla", "pipeline.exporters=[{type: {type: slices}}]"]
    with pytest.raises(InputError, match=r"exporters\.0\.type: unknown exporter"):
        load_plan(minimal("single", tmp_path), settings)
