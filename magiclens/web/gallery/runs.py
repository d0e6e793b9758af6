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
from magiclens.running.jobs import Job, finished_manifest, run_job

Say = Callable[[str], None]


def refresh(jobs: Sequence[Job], executor: Executor, registry: Registry, say: Say) -> None:
    """Run what is missing or outdated. Raises what the first failing run raised, once all others are done.

    Run folders appear whole, so that an interrupted build goes on where it was. Raises InputError, before anything is
    run, if a spec is wrong.
    """
    plans = [load_plan(job.spec, job.overrides, registry) for job in jobs]
    due = [job for job, plan in zip(jobs, plans, strict=True) if finished_manifest(plan, Path(job.out)) is None]
    say(f"{len(jobs)} lenses, {len(due)} to make")
    work = partial(run_job, registry=registry) if isinstance(executor, Serial) else run_job
    failures = []
    try:
        for job, made in zip(due, executor.map(work, due), strict=True):
            say(f"  {Path(job.out).name}: {_told(made)}")
            failures += [made] if isinstance(made, Exception) else []
    finally:
        _clear(due)
    for _ in raising(failures):
        pass


def _told(made: dict[str, Any] | Exception) -> str:
    return "failed" if isinstance(made, Exception) else f"{made['seconds']:.0f} s"


def _clear(due: Sequence[Job]) -> None:
    """Remove what processes that were killed have left unfinished."""
    for out in (Path(job.out) for job in due):
        for partly in out.parent.glob(f".{out.name}-*"):
            shutil.rmtree(partly, ignore_errors=True)
