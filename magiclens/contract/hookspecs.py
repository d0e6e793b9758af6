"""The hooks that a plugin can implement, in the order in which they are called.

A plugin is a module or an object with functions of these names, each marked with ``@hookimpl``, which its package names
in the group of entry points ``magiclens``. Hooks contribute something or observe a run; they never change data.
"""

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
"""The group of entry points in which packages name their plugins."""

CONTRACT = "2.0"
"""The version of everything that plugins rely on: hooks, stages, artifacts, the public names of ``magiclens``.

The second number grows when something is added, the first when something that plugins rely on is changed or removed.
"""

hookspec = pluggy.HookspecMarker("magiclens")
"""Marks the hooks of this file."""

hookimpl = pluggy.HookimplMarker("magiclens")
"""Marks a plugin's implementation of a hook."""


@hookspec
def mlens_stages() -> Sequence[type[Stage]]:  # type: ignore[empty-body]
    """Contribute classes of stages (see ``magiclens.contract.stages``)."""


@hookspec
def mlens_scenarios() -> Sequence[type[Any]]:  # type: ignore[empty-body]
    """Contribute classes of scenarios (see ``magiclens.Scenario``)."""


@hookspec
def mlens_art() -> dict[str, Callable[[int], Any]]:  # type: ignore[empty-body]
    """Contribute named pictures: functions from a size in pixels to (size, size, C), linear light, C = 1 or 3."""


@hookspec
def mlens_executors() -> Sequence[type[Executor]]:  # type: ignore[empty-body]
    """Contribute classes of executors (see ``magiclens.contract.executors``)."""


@hookspec
def mlens_analyses() -> Sequence[Any]:  # type: ignore[empty-body]
    """Contribute analyses (see ``magiclens.Analysis``), in the order of their figures in the report."""


@hookspec
def mlens_stage_done(stage: Stage, artifact: Any, seconds: float) -> None:
    """Observe a stage that is done. One whose result is in the cache is not done, and nobody is told of it.

    Built-in exporters work while the lens is analysed: the call may come from another thread, never during another.

    Args:
        stage: The stage with its options.
        artifact: What it has returned, checked. A file is moved to its place in the run folder after the call.
        seconds: How long it took.
    """


@hookspec
def mlens_run_done(folder: Path, manifest: dict[str, Any]) -> None:
    """Observe a run that is done.

    Args:
        folder: The run folder, complete.
        manifest: What its ``manifest.json`` holds.
    """


def contract_flaw(plugin: object) -> str | None:
    """Why a plugin cannot be used with this version of the contract.

    Args:
        plugin: A module or an object. Its ``mlens_contract`` is the version that it was written for; a plugin without
            one is accepted.

    Returns:
        What is wrong and what to upgrade; None if the plugin can be used.
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
