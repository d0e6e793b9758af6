"""Makes the runs that a gallery shows; runs that are there already and still valid are kept."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from magiclens.contract.executors import Executor, Serial, raising
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.jobs import RunJob, finished_manifest, run_job


def refresh_runs(jobs: Sequence[RunJob], executor: Executor, registry: Registry, say: Callable[[str], None]) -> None:
    """Make runs that are missing or outdated. Run folders appear whole, so that an interrupted build can go on.

    Args:
        jobs: The runs of the gallery.
        executor: Where runs are made.
        registry: Installed stages.
        say: Is given a line of text for each run.

    Raises:
        InputError: A spec is wrong; nothing has been run then.
        Exception: The error of the first run that failed, once all others are done.
    """
    plans = [load_plan(job.spec, job.overrides, registry) for job in jobs]
    due = [job for job, plan in zip(jobs, plans, strict=True) if finished_manifest(plan, Path(job.out)) is None]
    say(f"{len(jobs)} lenses, {len(due)} to make")
    # a registry cannot be sent to another process
    work = partial(run_job, registry=registry) if isinstance(executor, Serial) else run_job
    failures = []
    try:
        for job, made in zip(due, executor.map(work, due), strict=True):
            say(f"  {Path(job.out).name}: {_outcome(made)}")
            failures += [made] if isinstance(made, Exception) else []
    finally:
        _clear(due)
    for _ in raising(failures):
        pass


def _outcome(made: dict[str, Any] | Exception) -> str:
    return "failed" if isinstance(made, Exception) else f"{made['seconds']:.0f} s"


def _clear(due: Sequence[RunJob]) -> None:
    """Remove unfinished folders of processes that were killed."""
    for out in (Path(job.out) for job in due):
        for partly in out.parent.glob(f".{out.name}-*"):
            shutil.rmtree(partly, ignore_errors=True)
