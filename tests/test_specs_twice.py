"""The shipped specs as they are: run twice, they give equal files, and a mesh that slicers take. `pytest -m sweep`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from acceptors import assert_accepted
from lenses import SHIPPED, SPECS
from magiclens import run_spec


@pytest.mark.sweep
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_spec_gives_the_same_bytes_twice(name: str, tmp_path: Path) -> None:
    runs = (run_spec(SPECS / f"{name}.yaml", tmp_path / folder) for folder in ("one", "two"))
    one, two = (_without_timings(run.manifest) for run in runs)
    assert len(one["artifacts"]) > 10
    assert one == two
    assert_accepted(tmp_path / "one" / "lens.stl")


def _without_timings(manifest: dict[str, Any]) -> dict[str, Any]:
    """What must be equal; files are compared by their hashes."""
    whole: dict[str, Any] = json.loads(json.dumps(manifest))
    del whole["seconds"]
    for stage in whole["stages"]:
        del stage["seconds"]
    return whole
