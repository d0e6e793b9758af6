"""Lenses to measure with: those of the repository's specs, designed once per process."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import Candidates, HeightField, Scene
from magiclens.plan.compile import Plan, load_plan

_SPECS = Path(__file__).parents[1] / "specs"


@cache
def planned(spec: str, *overrides: str) -> tuple[Plan, Scene]:
    """The plan of a spec, and what it shows."""
    plan = load_plan(_SPECS / f"{spec}.yaml", overrides)
    return plan, plan.scene()


@cache
def candidates(spec: str, *overrides: str) -> Candidates:
    """What a spec's matcher finds."""
    plan, scene = planned(spec, *overrides)
    return plan.matcher.stage.match(scene, np.random.default_rng(0))


@cache
def lenslets(spec: str, *overrides: str) -> HeightField:
    """The spec's lens before its facets are refined."""
    plan, scene = planned(spec, *overrides)
    chosen = plan.annealer.stage.anneal(scene, candidates(spec, *overrides), np.random.default_rng(0))
    return plan.integrator.stage.integrate(scene, chosen)


@cache
def heights(spec: str, *overrides: str) -> HeightField:
    """The spec's lens, refined."""
    plan, scene = planned(spec, *overrides)
    return plan.integrator.stage.refine(scene, lenslets(spec, *overrides))
