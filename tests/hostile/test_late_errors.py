"""Errors that only a run can find carry the line of the option at fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magiclens.contract.artifacts import Candidates, Scene
from magiclens.contract.errors import InputError, MagicLensError, StageError
from magiclens.plan.compile import load_plan
from magiclens.running.pipeline import run_plan
from toys import TOYS, SpecWriter, ToyMatcher, registry_of


def matcher_that_raises(error: MagicLensError) -> type[ToyMatcher]:
    class Raising(ToyMatcher):
        def match(self, scene: Scene, rng: np.random.Generator, progress: Any = None) -> Candidates:
            raise error

    return Raising


@pytest.mark.parametrize(
    ("error", "place"),
    [
        (InputError("no.", keys=("sweeps",)), "14: pipeline.matcher.sweeps: no."),
        (InputError("no.", keys=("window", "sweeps")), "14: pipeline.matcher.sweeps: no."),
        (InputError("no.", keys=("lens.relief", "lens.size")), "7: lens.size: no."),
        (InputError("no.", keys=("window", "lens.relief")), "12: pipeline.matcher: no."),
        (StageError("no.", keys=("lens.facets",)), "8: lens.facets: matcher toy (magiclens-toys 1.2): no."),
    ],
)
def test_an_error_of_a_stage_says_where_its_option_was_written(
    error: MagicLensError, place: str, write_spec: SpecWriter, tmp_path: Path
) -> None:
    stages = [stage for stage in TOYS if stage is not ToyMatcher]
    plan = load_plan(write_spec(), [], registry_of(matcher_that_raises(error), *stages))
    with pytest.raises(type(error).__mro__[0]) as raised:
        run_plan(plan, tmp_path / "out")
    assert str(raised.value) == f"{tmp_path / 'toy.yaml'}:{place}"
    assert not (tmp_path / "out").exists()


def test_what_names_a_file_already_is_not_changed(write_spec: SpecWriter, tmp_path: Path) -> None:
    stages = [stage for stage in TOYS if stage is not ToyMatcher]
    raising = matcher_that_raises(InputError("no.", "other.png", keys=("sweeps",)))
    with pytest.raises(InputError, match=r"^other\.png: no\.$"):
        run_plan(load_plan(write_spec(), [], registry_of(raising, *stages)), tmp_path / "out")


@pytest.mark.tools
def test_a_facet_that_reaches_no_patch_names_the_slope_limit(tmp_path: Path) -> None:
    spec = Path(__file__).parents[2] / "specs" / "single.yaml"
    settings = ["lens.facets=4", "lens.microfacets=4", "lens.max_slope=0.1deg"]
    with pytest.raises(InputError) as raised:
        run_plan(load_plan(spec, settings), tmp_path / "out")
    assert str(raised.value).startswith(f"--set {settings[-1]}: lens.max_slope: facet (row 0, column 0) reaches")
