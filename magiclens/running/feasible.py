"""Can this machine run a plan? Asked before anything is computed, so that what passes ``mlens check`` can be run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from magiclens.config.document import Keys, dotted
from magiclens.config.model import LISTED_STAGES
from magiclens.contract.errors import InputError
from magiclens.plan.blame import blaming
from magiclens.plan.compile import Plan, Step


def require_feasible(plan: Plan) -> None:
    """Raise an InputError, with the line to change, if this machine cannot run the plan."""
    for at, step in _stages(plan):
        ask = getattr(step.stage, "lacks", None)  # a stage need not inherit from our base
        with blaming(f"{step}: lacks"):
            lack = ask() if ask else None
        if lack:
            raise InputError(f"{dotted(at)}: {lack}", plan.document.where(at))


def _stages(plan: Plan) -> Iterator[tuple[Keys, Step[Any]]]:
    """All stages, each with its place in the spec."""
    for step in plan.steps:
        if step.stage.kind not in LISTED_STAGES.values():
            yield ("pipeline", step.stage.kind), step
    for key in LISTED_STAGES:
        for k, step in enumerate(getattr(plan, key)):
            yield ("pipeline", key, k), step
