"""The hooks a plugin can implement, in calling order. Hooks contribute or observe; they never rewrite data."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pluggy

if TYPE_CHECKING:
    from magiclens.contract.executors import Executor
    from magiclens.contract.stages import Stage

ENTRY_POINT_GROUP = "magiclens"
CONTRACT = "2.0"
"""The version of everything that plugins rely on: hooks, stages, artifacts, the names of ``magiclens``.

The second number grows with what is added, the first when something that plugins rely on changes or goes.
"""
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
def mlens_executors() -> Sequence[type[Executor]]:  # type: ignore[empty-body]
    """Executor classes this plugin contributes (see magiclens.contract.executors)."""


@hookspec
def mlens_stage_done(stage: Stage, artifact: Any, seconds: float) -> None:
    """Observe: a stage has returned this artifact."""


@hookspec
def mlens_run_done(folder: Path, manifest: dict[str, Any]) -> None:
    """Observe: a run folder is complete."""


def contract_flaw(plugin: object) -> str | None:
    """Why a plugin cannot be used here, judged by the contract that it was written for, its ``mlens_contract``.

    A plugin that does not say is taken to fit.
    """
    written = getattr(plugin, "mlens_contract", CONTRACT)
    numbers = re.fullmatch(r"(\d+)\.(\d+)", written) if isinstance(written, str) else None
    if numbers is None:
        return f"mlens_contract is {written!r}; it is text such as {CONTRACT!r}"
    major, minor = map(int, numbers.groups())
    ours = tuple(map(int, CONTRACT.split(".")))
    if (major, minor) > ours:
        return f"it is written for contract {written}, this magiclens has {CONTRACT}: upgrade magiclens"
    if major < ours[0]:
        return f"it is written for contract {written}, this magiclens has {CONTRACT}: upgrade the plugin"
    return None
