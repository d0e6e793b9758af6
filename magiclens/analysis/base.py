"""The contract of analyses: one question about a finished lens, its answer in numbers, and the figures that show it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.plan.compile import Plan


@dataclass(frozen=True)
class Findings:
    """The answer of an analysis.

    Attributes:
        metrics: Numbers for the manifest, by a name that ends in their unit, such as ``step_mean_mm``.
        details: What the figures are drawn from; only the analysis itself looks inside.
        pictures: (H, W, C) float32 in linear light, 0 to 1, by the name of the file that ``figures/`` gets.
    """

    metrics: Mapping[str, float] = field(default_factory=dict)
    details: Any = None
    pictures: Mapping[str, FloatArray] = field(default_factory=dict)


def always(plan: Plan) -> bool:
    """Every lens can be asked."""
    return True


def nothing(plan: Plan, result: RunResult) -> Findings:
    """There is nothing to compute: the figures are drawn from the result alone."""
    return Findings()


def no_figures(result: RunResult, findings: Findings) -> list[Figure]:
    """The findings are numbers only."""
    return []


@dataclass(frozen=True)
class Analysis:
    """One question about a finished lens. Analyses are pure; the run writes what they find.

    They ask of the lens, not of its files: the plan that ``compute`` is given has neither exporters nor the name of the
    spec, and the manifest that ``figures`` is given has ``metrics`` alone.

    Attributes:
        name: What ``report.analyses`` of a spec calls it, in lower case with hyphens.
        applies: Whether lenses of this plan can be asked.
        compute: The answer; None if this lens turns out to have none.
        figures: The answer drawn, for ``figures/`` and the report.
        repeatable: Whether equal lenses get equal answers, so that these are kept, as ``Stage.repeatable`` says.
    """

    name: str
    applies: Callable[[Plan], bool] = always
    compute: Callable[[Plan, RunResult], Findings | None] = nothing
    figures: Callable[[RunResult, Findings], Sequence[Figure]] = no_figures
    repeatable: bool = True
