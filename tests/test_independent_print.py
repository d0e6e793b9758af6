"""Prints of shipped specs, by a model of printing that shares no code with the simulation. `pytest -m sweep`."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from lenses import SPECS
from magiclens import run_spec
from magiclens.running.open_run import open_run

BENCHMARK = Path(__file__).parent.parent / "benchmarks" / "independent_print.py"


@pytest.fixture(scope="module")
def independent() -> ModuleType:
    """The benchmark as a module."""
    spec = importlib.util.spec_from_file_location(BENCHMARK.stem, BENCHMARK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["printed-single", "printed-rotating", "printed-universal", "printed-lcd"])
def test_an_independent_print_shows_what_the_simulation_foresees(
    name: str, tmp_path: Path, independent: ModuleType
) -> None:
    # printers with a screen read other archives, whose layers are the same
    files = "pipeline.exporters=[{type: stl}, {type: slices}]"
    run_spec(SPECS / f"{name}.yaml", tmp_path / "run", ["report.analyses=[as-made]", files])
    for slicing, (shown_db, foreseen_db) in independent.compare(open_run(tmp_path / "run")).items():
        assert shown_db == pytest.approx(foreseen_db, abs=1.0), slicing
