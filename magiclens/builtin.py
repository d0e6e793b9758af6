"""The plugin that contributes everything built in, through the hooks that every plugin uses.

Stages import numba, scipy, pymeshlab and mitsuba only when they run, so that listing them here is quick.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from magiclens.contract.hookspecs import hookimpl

if TYPE_CHECKING:
    from magiclens.analysis.base import Analysis
    from magiclens.contract.artifacts import FloatArray
    from magiclens.contract.executors import Executor
    from magiclens.contract.stages import Stage
    from magiclens.scenarios.base import Scenario


@hookimpl
def mlens_stages() -> Sequence[type[Stage]]:
    """Every built-in stage, in pipeline order."""
    from magiclens.annealing.heat_bath import HeatBath
    from magiclens.annealing.metropolis import Metropolis
    from magiclens.encoding.least_squares import LeastSquaresEncoder
    from magiclens.exporting.gltf import Glb
    from magiclens.exporting.height_map import HeightMap
    from magiclens.exporting.jig import Jig
    from magiclens.exporting.mesh_files import Obj, Ply, Stl
    from magiclens.exporting.monitor import Monitor
    from magiclens.exporting.print_sheet import PrintSheet
    from magiclens.exporting.slices import Sl1, Slices
    from magiclens.exporting.three_mf import ThreeMf
    from magiclens.integration.least_squares import LeastSquaresIntegrator
    from magiclens.integration.poisson import Poisson
    from magiclens.matching.dart_throwing import DartThrowing
    from magiclens.matching.exhaustive import Exhaustive
    from magiclens.matching.multi_view import MultiViewMatcher
    from magiclens.meshing.manifold import ManifoldFinisher
    from magiclens.meshing.pymeshlab import Pymeshlab
    from magiclens.milling.gcode import Gcode
    from magiclens.milling.rml import Rml
    from magiclens.rendering.mitsuba import Mitsuba
    from magiclens.rendering.tracer import Tracer

    matching: list[type[Stage]] = [Exhaustive, MultiViewMatcher, DartThrowing]
    shaping: list[type[Stage]] = [HeatBath, Metropolis, Poisson, LeastSquaresIntegrator]
    finishing: list[type[Stage]] = [Pymeshlab, ManifoldFinisher, LeastSquaresEncoder]
    meshes: list[type[Stage]] = [Stl, Ply, Obj, ThreeMf, Glb]
    machines: list[type[Stage]] = [HeightMap, Slices, Sl1, Gcode, Rml, PrintSheet, Monitor, Jig]
    return [*matching, *shaping, *finishing, *meshes, *machines, Tracer, Mitsuba]


@hookimpl
def mlens_scenarios() -> Sequence[type[Scenario]]:
    """Every built-in scenario."""
    from magiclens.scenarios.multi_pair import MultiPair
    from magiclens.scenarios.multi_view import MultiView
    from magiclens.scenarios.question_answer import QuestionAnswer
    from magiclens.scenarios.rotating import Rotating
    from magiclens.scenarios.single import Single
    from magiclens.scenarios.stable_zone import StableZone
    from magiclens.scenarios.universal_animation import UniversalAnimation

    return [Single, Rotating, MultiPair, MultiView, StableZone, UniversalAnimation, QuestionAnswer]


@hookimpl
def mlens_analyses() -> Sequence[Analysis]:
    """Every built-in analysis, in the order of the report's figures."""
    from magiclens.analysis.annealing_effect import ANNEALING_EFFECT
    from magiclens.analysis.as_made import AS_MADE
    from magiclens.analysis.contact_sheet import CONTACT_SHEET
    from magiclens.analysis.ideal_picture import IDEAL_PICTURE
    from magiclens.analysis.leaks import LEAKS
    from magiclens.analysis.overlap import OVERLAP
    from magiclens.analysis.picture_error import PICTURE_ERROR
    from magiclens.analysis.ray_error import RAY_ERROR
    from magiclens.analysis.secrecy import SECRECY
    from magiclens.analysis.source_changes import SOURCE_CHANGES
    from magiclens.analysis.stable_zone import STABLE_ZONE
    from magiclens.analysis.surface import SURFACE
    from magiclens.analysis.tolerances import TOLERANCES
    from magiclens.analysis.warp import WARP

    shown = [AS_MADE, CONTACT_SHEET, STABLE_ZONE, TOLERANCES]
    figures = [*shown, WARP, SECRECY, PICTURE_ERROR, SURFACE, RAY_ERROR, ANNEALING_EFFECT, OVERLAP]
    return [*figures, IDEAL_PICTURE, SOURCE_CHANGES, LEAKS]


@hookimpl
def mlens_executors() -> Sequence[type[Executor]]:
    """Every built-in executor."""
    from magiclens.contract.executors import Processes, Serial

    return [Serial, Processes]


@hookimpl
def mlens_art() -> dict[str, Callable[[int], FloatArray]]:
    """Every built-in picture."""
    from magiclens.images.art import ART

    return dict(ART)
