"""Runs each combination that has no run folder yet, and writes the sheet that compares them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from magiclens.contract.errors import InputError, MagicLensError
from magiclens.contract.executors import Executor, Serial
from magiclens.plan.blame import blaming
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.folder import MANIFEST
from magiclens.running.jobs import RunJob, finished_manifest, run_job
from magiclens.running.replacing import atomic_file, clear_leftovers
from magiclens.sweep.combine import Combination, combinations
from magiclens.sweep.page import combination_pictures, sweep_image, sweep_page
from magiclens.sweep.results import Sweep, SweepResult
from magiclens.sweep.table import sweep_csv, sweep_json

_SHEET = ("png", "html", "csv", "json")
"""Endings of the files of a sheet; they appear from the last to the first."""


def sweep_spec(
    spec: str | Path,
    settings: Iterable[str],
    out_dir: str | Path | None = None,
    executor: Executor | None = None,
    registry: Registry | None = None,
    say: Callable[[str], None] = lambda _: None,
    sandbox: bool = False,
) -> Sweep:
    """Run a spec with every combination of some values, and write the sheet that compares the lenses.

    Combinations that are finished already are not run again, and one that fails stops no other.

    Args:
        spec: The spec's file.
        settings: ``key=value,value`` for each key that changes.
        out_dir: The sweep's folder, ``out/<name>-sweep`` by default.
        executor: Where runs are made; one after the other in this process by default.
        registry: Installed stages.
        say: Is given one line of text after each run.
        sandbox: Whether files outside of the spec's folder are mistakes.

    Raises:
        InputError: A setting or one of the resulting specs is wrong; nothing has been run then.
    """
    found, registry = combinations(settings), registry or Registry.load()
    plans = {one: load_plan(spec, one.overrides, registry, sandbox) for one in found}
    folder = Path(out_dir or Path("out", f"{plans[found[0]].spec.name}-sweep"))
    _refuse_other_folders(folder)
    results = {one: finished_manifest(plan, folder / one.folder) for one, plan in plans.items()}
    due = [one for one, manifest in results.items() if manifest is None]
    say(f"{len(found)} combinations, {len(due)} to run")
    settled = [SweepResult(one, manifest) for one, manifest in results.items() if manifest is not None]
    settled += _run(due, Path(spec), folder, executor or Serial(), registry, say)
    done = Sweep(folder, Path(spec).name, tuple(sorted(settled, key=lambda result: found.index(result.combination))))
    _write_sheet(done)
    return done


def _run(
    due: list[Combination],
    spec: Path,
    folder: Path,
    executor: Executor,
    registry: Registry,
    say: Callable[[str], None],
) -> list[SweepResult]:
    """Run combinations; in this process they use this registry, in others the stages that are installed there."""
    if not due:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    # a registry cannot be sent to another process
    work = partial(run_job, registry=registry) if isinstance(executor, Serial) else run_job
    jobs = [RunJob(str(spec.absolute()), one.overrides, str((folder / one.folder).absolute())) for one in due]
    results = []
    try:
        with blaming(f"executor {executor.type}"):
            for one, made in zip(due, executor.map(work, jobs), strict=True):
                results.append(_result(one, made))
                say(f"{len(results)}/{len(due)}  {one.label}: {results[-1].outcome}")
    finally:
        _clear(folder, due)
    return results


def _result(combination: Combination, made: Mapping[str, Any] | Exception) -> SweepResult:
    if isinstance(made, MagicLensError):
        return SweepResult(combination, None, str(made))
    if isinstance(made, Exception):
        return SweepResult(combination, None, f"{type(made).__name__}: {made}")
    return SweepResult(combination, made)


def _clear(folder: Path, due: list[Combination]) -> None:
    """Remove unfinished folders of processes that were killed, and the sweep's folder if nothing was finished."""
    for one in due:
        clear_leftovers(folder / one.folder)
    # rmdir fails on a folder that is not empty
    with suppress(OSError):
        folder.rmdir()


def _refuse_other_folders(folder: Path) -> None:
    """Raise InputError if the sweep's folder is a run folder or a file."""
    if (folder / MANIFEST).is_file() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"'{folder}' is there already and is no folder of a sweep; choose another --out", "--out")


def _write_sheet(done: Sweep) -> None:
    """Write all files of the sheet, or none."""
    shown = combination_pictures(done)
    with ExitStack() as written:
        path = {name: written.enter_context(atomic_file(done.folder / f"sweep.{name}")) for name in _SHEET}
        path["json"].write_text(sweep_json(done), encoding="utf-8")
        path["csv"].write_text(sweep_csv(done), encoding="utf-8", newline="")
        path["html"].write_text(sweep_page(done, shown), encoding="utf-8")
        sweep_image(done, shown).save(path["png"], "PNG", compress_level=4)
