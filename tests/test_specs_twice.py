"""The shipped specs as they are: run twice, they give equal files, and a mesh that slicers take. `pytest -m sweep`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from acceptors import assert_accepted
from magiclens import run_spec

SPECS = sorted((Path(__file__).parent.parent / "specs").glob("*.yaml"))


@pytest.mark.sweep
@pytest.mark.parametrize("spec", SPECS, ids=[path.stem for path in SPECS])
def test_a_shipped_spec_gives_the_same_bytes_twice(spec: Path, tmp_path: Path) -> None:
    one, two = (_without_timings(run_spec(spec, tmp_path / name).manifest) for name in ("one", "two"))
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
