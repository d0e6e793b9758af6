"""Runs every combination that has no run folder yet, and writes the sheet that compares them."""

from __future__ import annotations

import glob
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from magiclens.contract.errors import InputError, MagicLensError
from magiclens.contract.executors import Executor, Serial
from magiclens.plan.blame import blaming
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.folder import MANIFEST
from magiclens.running.jobs import Job, finished_manifest, run_job
from magiclens.sweep.combine import Combination, combinations

Say = Callable[[str], None]


@dataclass(frozen=True)
class Result:
    """A combination and the manifest of its run, or why there is none."""

    combination: Combination
    manifest: Mapping[str, Any] | None
    error: str = ""

    @property
    def outcome(self) -> str:
        """How long it took, or why it failed."""
        return f"{self.manifest['seconds']:.1f} s" if self.manifest else f"failed: {self.error}"


@dataclass(frozen=True)
class Sweep:
    """A finished sweep: a folder with a run folder per combination and the sheet; ``spec`` is the file's name."""

    folder: Path
    spec: str
    results: tuple[Result, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """What was changed."""
        return tuple(key for key, _ in self.results[0].combination.values)

    @property
    def failed(self) -> bool:
        """Whether some combination has no run."""
        return any(result.manifest is None for result in self.results)


def sweep_spec(
    spec: str | Path,
    settings: Iterable[str],
    out_dir: str | Path | None = None,
    executor: Executor | None = None,
    registry: Registry | None = None,
    say: Say = lambda _: None,
) -> Sweep:
    """Run a spec with every combination of ``key=value,value`` settings; ``out/<name>-sweep`` unless told otherwise.

    What is finished already is not run again, a combination that fails stops no other. ``say`` is told about each.
    Raises InputError, before anything is run, when a setting or one of the specs that result is wrong.
    """
    found, registry = combinations(settings), registry or Registry.load()
    plans = {one: load_plan(spec, one.overrides, registry) for one in found}
    folder = Path(out_dir or Path("out", f"{plans[found[0]].spec.name}-sweep"))
    _refuse_strangers(folder)
    results = {one: finished_manifest(plan, folder / one.folder) for one, plan in plans.items()}
    due = [one for one, manifest in results.items() if manifest is None]
    say(f"{len(found)} combinations, {len(due)} to run")
    settled = [Result(one, manifest) for one, manifest in results.items() if manifest is not None]
    settled += _run(due, Path(spec), folder, executor or Serial(), registry, say)
    done = Sweep(folder, Path(spec).name, tuple(sorted(settled, key=lambda result: found.index(result.combination))))
    _write_sheet(done)
    return done


def _run(
    due: list[Combination], spec: Path, folder: Path, executor: Executor, registry: Registry, say: Say
) -> list[Result]:
    """Run these combinations; in this process they use this very registry, elsewhere what is installed there."""
    if not due:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    work = partial(run_job, registry=registry) if isinstance(executor, Serial) else run_job
    jobs = [Job(str(spec.absolute()), one.overrides, str((folder / one.folder).absolute())) for one in due]
    results = []
    try:
        with blaming(f"executor {executor.type}"):
            for one, made in zip(due, executor.map(work, jobs), strict=True):
                results.append(_result(one, made))
                say(f"{len(results)}/{len(due)}  {one.label}: {results[-1].outcome}")
    finally:
        _clear(folder, due)
    return results


def _result(combination: Combination, made: Mapping[str, Any] | Exception) -> Result:
    if isinstance(made, MagicLensError):
        return Result(combination, None, str(made))
    if isinstance(made, Exception):
        return Result(combination, None, f"{type(made).__name__}: {made}")
    return Result(combination, made)


def _clear(folder: Path, due: list[Combination]) -> None:
    """Remove what processes that were killed have left unfinished, and the folder itself if nothing was finished."""
    for one in due:
        for partly in folder.glob(f".{glob.escape(one.folder)}-*"):
            shutil.rmtree(partly, ignore_errors=True)
    with suppress(OSError):
        folder.rmdir()


def _refuse_strangers(folder: Path) -> None:
    """A sweep can go on in its folder, but not within a run folder, nor in a file."""
    if (folder / MANIFEST).is_file() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"'{folder}' is there already and is no folder of a sweep; choose another --out", "--out")


def _write_sheet(done: Sweep) -> None:
    """Write all files of the sheet, or none."""
    from magiclens.sweep.page import contact_sheet, page, pictures
    from magiclens.sweep.table import as_csv, as_json

    shown = pictures(done)
    done.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".sheet-", dir=done.folder) as scratch:
        written = Path(scratch)
        (written / "sweep.json").write_text(as_json(done), encoding="utf-8")
        (written / "sweep.csv").write_text(as_csv(done), encoding="utf-8", newline="")
        (written / "sweep.html").write_text(page(done, shown), encoding="utf-8")
        contact_sheet(done, shown).save(written / "sweep.png", "PNG", compress_level=4)
        for path in sorted(written.iterdir()):
            os.replace(path, done.folder / path.name)
