"""Makes the runs that a gallery shows; those that are there already, and are still what they would be, stay."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from magiclens.contract.executors import Executor, Serial, raising
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.jobs import Task, finished, make

Say = Callable[[str], None]


def refresh(tasks: Sequence[Task], executor: Executor, registry: Registry, say: Say) -> None:
    """Run what is missing or outdated. Raises what the first failing run raised, once all others are done.

    Run folders appear whole, so that an interrupted build goes on where it was. Raises InputError, before anything is
    run, if a spec is wrong.
    """
    plans = [load_plan(task.spec, task.overrides, registry) for task in tasks]
    due = [task for task, plan in zip(tasks, plans, strict=True) if finished(plan, Path(task.out)) is None]
    say(f"{len(tasks)} lenses, {len(due)} to make")
    work = partial(make, registry=registry) if isinstance(executor, Serial) else make
    failures = []
    try:
        for task, made in zip(due, executor.map(work, due), strict=True):
            say(f"  {Path(task.out).name}: {_told(made)}")
            failures += [made] if isinstance(made, Exception) else []
    finally:
        _clear(due)
    for _ in raising(failures):
        pass


def _told(made: dict[str, Any] | Exception) -> str:
    return "failed" if isinstance(made, Exception) else f"{made['seconds']:.0f} s"


def _clear(due: Sequence[Task]) -> None:
    """Remove what processes that were killed have left unfinished."""
    for out in (Path(task.out) for task in due):
        for partly in out.parent.glob(f".{out.name}-*"):
            shutil.rmtree(partly, ignore_errors=True)
