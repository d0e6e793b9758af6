"""Every numeric option of every scenario and stage at bad values: ``mlens check`` refuses it, or it can be run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magiclens.cache.store import Cache
from magiclens.config.document import document_of
from magiclens.contract.errors import InputError
from magiclens.images.files import write_png
from magiclens.plan.compile import Plan, compile_plan
from magiclens.plan.registry import Registry
from magiclens.running.feasible import require_feasible
from magiclens.running.open_run import open_run
from magiclens.running.pipeline import run_plan
from numeric import BAD, PICTURE, NumericOption, all_numeric_options

INSTALLED = Registry.load()
OPTIONS = list(all_numeric_options(INSTALLED))


@pytest.fixture
def beside_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(Path(PICTURE), np.full((40, 40, 1), 0.5, np.float32))


def planned(data: dict[str, Any], option: NumericOption, value: str) -> Plan:
    """The plan of a spec with an option at a value, checked as ``mlens check`` does."""
    plan = compile_plan(document_of(data, [*option.beside, option.override(value)]), INSTALLED)
    plan.shots()
    require_feasible(plan)
    return plan


def test_numbers_are_found_everywhere() -> None:
    paths = {option.path for _, option in OPTIONS}
    assert {"lens.size", "scenario.source.radius", "pipeline.matcher.window", "pipeline.exporters.0.feed"} <= paths
    assert {"scenario.views.0.eye.tilt", "pipeline.encoder.camouflage.grain", "medium.black"} <= paths
    assert {option.unit for _, option in OPTIONS} == {"", "mm", "deg", "%", "mm/min"}
    assert len(OPTIONS) > 150


@pytest.mark.tools
@pytest.mark.usefixtures("beside_a_picture")
def test_check_refuses_a_bad_number_at_its_key_or_lets_it_run() -> None:
    wrong, allowed = [], 0
    for data, option in OPTIONS:
        compile_plan(document_of(data, option.beside), INSTALLED)  # without the bad value, nothing is wrong
        for value in BAD:
            try:
                planned(data, option, value)
                allowed += 1
                if value in (".nan", ".inf", "1e308"):
                    wrong.append(f"{option.override(value)} is allowed")
            except InputError as error:
                if not names(error, option):
                    wrong.append(f"{option.override(value)}: {error}")
    assert wrong == []
    assert allowed < len(OPTIONS) * len(BAD) / 8  # zero and almost nothing may mean something, the others rarely


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """What these runs have in common, such as the lens where a number is an exporter's."""
    return Cache(tmp_path_factory.mktemp("kept"), 10**9)


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tolerances are measured on coarse pictures: nobody looks at them."""
    monkeypatch.setattr("magiclens.analysis.tolerances.RESOLUTION", 32)
    monkeypatch.setattr("magiclens.analysis.tolerances.MAP_RESOLUTION", 16)


@pytest.mark.sweep
@pytest.mark.usefixtures("beside_a_picture", "coarse")
@pytest.mark.parametrize(
    ("data", "option", "value"),
    [pytest.param(data, o, v, id=f"{data['scenario']['type']}-{o.override(v)}") for data, o in OPTIONS for v in BAD],
)
def test_what_passes_check_can_be_run(
    data: dict[str, Any], option: NumericOption, value: str, kept: Cache, tmp_path: Path
) -> None:
    try:
        plan = planned(data, option, value)
    except InputError:
        return  # the test above looks at what it says
    run_plan(plan, tmp_path / "out", cache=kept)
    manifest = open_run(tmp_path / "out").files.manifest
    numbers = [*manifest["metrics"].values(), *(view["psnr_db"] for view in manifest["views"])]
    # a renderer that is left out, or an analysis that finds nothing, has no number
    assert all(math.isfinite(number) for number in numbers if number is not None)


def names(error: InputError, option: NumericOption) -> bool:
    """Whether an error is about an option, or about what directly holds it: some values only clash with others."""
    place = error.message.split(": ")[0]
    return place == option.path or place.startswith(option.path) or place == option.path.rpartition(".")[0]
