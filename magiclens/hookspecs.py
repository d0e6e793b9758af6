"""The hooks a plugin can implement, in calling order. Hooks contribute or observe; they never rewrite data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pluggy

if TYPE_CHECKING:
    from magiclens.stages import Stage

ENTRY_POINT_GROUP = "magiclens"
hookspec = pluggy.HookspecMarker("magiclens")
hookimpl = pluggy.HookimplMarker("magiclens")


@hookspec
def mlens_stages() -> Sequence[type[Stage]]:  # type: ignore[empty-body]
    """Stage classes this plugin contributes."""


@hookspec
def mlens_scenarios() -> Sequence[type[Any]]:  # type: ignore[empty-body]
    """Scenario classes this plugin contributes (see magiclens.scenarios.Scenario)."""


@hookspec
def mlens_art() -> dict[str, Callable[[int], Any]]:  # type: ignore[empty-body]
    """Named pictures: a function from a size in pixels to an (size, size, C) float32 array in linear light."""


@hookspec
def mlens_stage_done(stage: Stage, artifact: Any, seconds: float) -> None:
    """Observe: a stage has returned this artifact."""


@hookspec
def mlens_run_done(folder: Path, manifest: dict[str, Any]) -> None:
    """Observe: a run folder is complete."""
