"""Designs magic lenses. These names are the public API; plugins import nothing else."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from magiclens.artifacts import (
        Assignment,
        Candidates,
        FloatArray,
        HeightField,
        IntArray,
        Lens,
        Scene,
        Solid,
        Transport,
        View,
    )
    from magiclens.errors import InputError, MagicLensError, StageError
    from magiclens.executors import Executor, raising
    from magiclens.facets import central_slopes
    from magiclens.hookspecs import CONTRACT, hookimpl
    from magiclens.images import Score, resize, score, to_display, to_linear
    from magiclens.matching.exhaustive import Exhaustive
    from magiclens.matching.polished import polished
    from magiclens.plan import Plan, load_plan
    from magiclens.running import Run, run, run_plan, run_spec
    from magiclens.scenarios.base import Scenario, Shot
    from magiclens.scenarios.pictures import Source, Target
    from magiclens.spec.load import load_spec
    from magiclens.spec.model import Spec, Viewer
    from magiclens.stages import (
        Annealer,
        Encoder,
        Exporter,
        Finisher,
        Integrator,
        Matcher,
        Progress,
        Renderer,
        Stage,
        silent,
    )
    from magiclens.traced import transports
    from magiclens.units import Angle, Fraction, Length, LengthOrPercent, relative

__version__ = "0.1.0"

_HOMES = {
    "artifacts": "Assignment Candidates FloatArray HeightField IntArray Lens Scene Solid Transport View",
    "errors": "InputError MagicLensError StageError",
    "executors": "Executor raising",
    "facets": "central_slopes",
    "hookspecs": "CONTRACT hookimpl",
    "images": "Score resize score to_display to_linear",
    "matching.exhaustive": "Exhaustive",
    "matching.polished": "polished",
    "plan": "Plan load_plan",
    "running": "Run run run_plan run_spec",
    "scenarios.base": "Scenario Shot",
    "scenarios.pictures": "Source Target",
    "spec.load": "load_spec",
    "spec.model": "Spec Viewer",
    "stages": "Annealer Encoder Exporter Finisher Integrator Matcher Progress Renderer Stage silent",
    "traced": "transports",
    "units": "Angle Fraction Length LengthOrPercent relative",
}
_HOME_OF = {name: f"magiclens.{home}" for home, names in _HOMES.items() for name in names.split()}

__all__ = [
    "CONTRACT",
    "Angle",
    "Annealer",
    "Assignment",
    "Candidates",
    "Encoder",
    "Executor",
    "Exhaustive",
    "Exporter",
    "Finisher",
    "FloatArray",
    "Fraction",
    "HeightField",
    "InputError",
    "IntArray",
    "Integrator",
    "Length",
    "LengthOrPercent",
    "Lens",
    "MagicLensError",
    "Matcher",
    "Plan",
    "Progress",
    "Renderer",
    "Run",
    "Scenario",
    "Scene",
    "Score",
    "Shot",
    "Solid",
    "Source",
    "Spec",
    "Stage",
    "StageError",
    "Target",
    "Transport",
    "View",
    "Viewer",
    "central_slopes",
    "hookimpl",
    "load_plan",
    "load_spec",
    "polished",
    "raising",
    "relative",
    "resize",
    "run",
    "run_plan",
    "run_spec",
    "score",
    "silent",
    "to_display",
    "to_linear",
    "transports",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for, so that ``import magiclens`` costs nothing."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'magiclens' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
