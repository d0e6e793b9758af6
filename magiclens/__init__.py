"""Designs magic lenses. These names are the public API; plugins import nothing else."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from magiclens.analysis.base import Analysis, Findings
    from magiclens.config.load import load_spec
    from magiclens.config.model import Spec, Viewer
    from magiclens.contract.artifacts import (
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
    from magiclens.contract.errors import InputError, MagicLensError, StageError
    from magiclens.contract.executors import Executor, raising
    from magiclens.contract.hookspecs import CONTRACT, hookimpl
    from magiclens.contract.stages import (
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
    from magiclens.contract.units import Angle, Fraction, Length, LengthOrPercent, relative
    from magiclens.geometry.facets import central_slopes
    from magiclens.images import Score, art, read_image, resize, score, to_display, to_linear, write_png
    from magiclens.images.movies import read_frames
    from magiclens.kernels.spreading import Spreader, is_spread, shares, spread, spreading_by
    from magiclens.matching.exhaustive import Exhaustive
    from magiclens.matching.options import MatchingOptions
    from magiclens.matching.polishing import polished
    from magiclens.milling.cutter import Cutter
    from magiclens.milling.exporter import MillingExporter
    from magiclens.milling.line_milling import LineMilling
    from magiclens.milling.program import MillingProgram, MillingSetup
    from magiclens.milling.toolpath import Moves
    from magiclens.plan.compile import Plan, load_plan
    from magiclens.rendering.poses import Pose
    from magiclens.rendering.transports import transports
    from magiclens.running.open_run import OpenRun, open_run
    from magiclens.running.pipeline import Run, run, run_plan, run_spec
    from magiclens.scenarios.base import Scenario, Shot
    from magiclens.scenarios.pictures import Source, Target

__version__ = "0.1.0"

_HOMES = {
    "analysis.base": "Analysis Findings",
    "config.load": "load_spec",
    "config.model": "Spec Viewer",
    "contract.artifacts": "Assignment Candidates FloatArray HeightField IntArray Lens Scene Solid Transport View",
    "contract.errors": "InputError MagicLensError StageError",
    "contract.executors": "Executor raising",
    "contract.hookspecs": "CONTRACT hookimpl",
    "contract.stages": "Annealer Encoder Exporter Finisher Integrator Matcher Progress Renderer Stage silent",
    "contract.units": "Angle Fraction Length LengthOrPercent relative",
    "geometry.facets": "central_slopes",
    "images": "Score art read_image resize score to_display to_linear write_png",
    "images.movies": "read_frames",
    "kernels.spreading": "Spreader is_spread shares spread spreading_by",
    "matching.exhaustive": "Exhaustive",
    "matching.options": "MatchingOptions",
    "matching.polishing": "polished",
    "milling.cutter": "Cutter",
    "milling.exporter": "MillingExporter",
    "milling.line_milling": "LineMilling",
    "milling.program": "MillingProgram MillingSetup",
    "milling.toolpath": "Moves",
    "plan.compile": "Plan load_plan",
    "rendering.poses": "Pose",
    "rendering.transports": "transports",
    "running.open_run": "OpenRun open_run",
    "running.pipeline": "Run run run_plan run_spec",
    "scenarios.base": "Scenario Shot",
    "scenarios.pictures": "Source Target",
}
_HOME_OF = {name: f"magiclens.{home}" for home, names in _HOMES.items() for name in names.split()}

__all__ = [
    "CONTRACT",
    "Analysis",
    "Angle",
    "Annealer",
    "Assignment",
    "Candidates",
    "Cutter",
    "Encoder",
    "Executor",
    "Exhaustive",
    "Exporter",
    "Findings",
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
    "LineMilling",
    "MagicLensError",
    "Matcher",
    "MatchingOptions",
    "MillingExporter",
    "MillingProgram",
    "MillingSetup",
    "Moves",
    "OpenRun",
    "Plan",
    "Pose",
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
    "Spreader",
    "Stage",
    "StageError",
    "Target",
    "Transport",
    "View",
    "Viewer",
    "art",
    "central_slopes",
    "hookimpl",
    "is_spread",
    "load_plan",
    "load_spec",
    "open_run",
    "polished",
    "raising",
    "read_frames",
    "read_image",
    "relative",
    "resize",
    "run",
    "run_plan",
    "run_spec",
    "score",
    "shares",
    "silent",
    "spread",
    "spreading_by",
    "to_display",
    "to_linear",
    "transports",
    "write_png",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for, so that ``import magiclens`` costs nothing."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'magiclens' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
