"""The commands that read a spec: ``mlens run``, ``mlens check`` and ``mlens plan``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magiclens.cli.common import (
    AsJson,
    ExecutorName,
    ExecutorSettings,
    Overrides,
    Quiet,
    Sandbox,
    SpecFile,
    Traceback,
    chosen_executor,
    print_note,
    print_result,
    reporting,
)
from magiclens.contract.errors import InputError

if TYPE_CHECKING:
    from magiclens.contract.executors import Executor
    from magiclens.plan.compile import Plan
    from magiclens.running.observers import Observer


def run_command(
    spec: SpecFile,
    overrides: Overrides,
    executor_settings: ExecutorSettings,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The run folder.", show_default="out/NAME")
    ] = None,
    no_cache: Annotated[
        bool,
        typer.Option("--no-cache", help="Do everything; neither keep results nor use what earlier runs have kept."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the run of another spec that is at --out.")] = False,
    executor: ExecutorName = "serial",
    sandbox: Sandbox = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """Design the lens of SPEC and write a run folder: mesh, source, simulated photographs, manifest.

    What an earlier run has kept is not done again, also after that run was killed. An executor that has other machines,
    such as dask, spreads what takes longest over them.
    """
    with reporting(traceback):
        from magiclens.cache.folder import keep_nothing
        from magiclens.plan.compile import load_plan
        from magiclens.running.feasible import estimate_text, require_feasible
        from magiclens.running.folder import require_same_name
        from magiclens.running.observers import Observer, terminal_observer
        from magiclens.running.pipeline import kept_run
        from magiclens.running.termination import end_on_sigterm

        began = perf_counter()
        end_on_sigterm()
        if no_cache:
            keep_nothing()
        # progress goes to standard error, so that standard output holds the result alone
        observer = Observer() if quiet or as_json else terminal_observer(sys.stderr)
        worker, registry = chosen_executor(executor, executor_settings)
        plan = load_plan(spec, overrides, registry, sandbox)
        folder = out or Path("out", plan.spec.name)
        if not force:
            require_same_name(folder, plan.spec.name)
        needs = require_feasible(plan)
        manifest = kept_run(plan, folder, observer)
        if manifest is None:
            if not (quiet or as_json):
                observer.notice(estimate_text(needs))
            manifest = _run(plan, worker, spec, overrides, folder, observer)
        if not (quiet or as_json):
            print_note(f"it took {perf_counter() - began:.1f} seconds")
        print_result(lambda: _summary(folder, manifest), lambda: {"folder": str(folder), **manifest}, quiet, as_json)


def check_command(
    spec: SpecFile,
    overrides: Overrides,
    sandbox: Sandbox = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """Check SPEC without running it. With --json, all of its mistakes are listed under ``errors``."""
    with reporting(traceback):
        from magiclens.plan.compile import load_plan
        from magiclens.running.feasible import require_feasible

        try:
            plan = load_plan(spec, overrides, sandbox=sandbox)
            require_feasible(plan)
        except InputError as error:
            if as_json:
                mistakes = error.mistakes()
                print_result(str, lambda: {"spec": str(spec), "errors": mistakes}, as_json=True)
            raise
        _print_notices(plan, quiet or as_json)
        scenario, views = plan.scenario.type, [shot.name for shot in plan.shots()]
        data = {"spec": str(spec), "name": plan.spec.name, "scenario": scenario, "views": views, "errors": []}
        print_result(lambda: f"{spec}: ok, {scenario}, views: {', '.join(views)}", lambda: data, quiet, as_json)


def plan_command(
    spec: SpecFile,
    overrides: Overrides,
    why: Annotated[
        bool, typer.Option("--why", help="Show instead which steps a run would do, and why they are not in the cache.")
    ] = False,
    sandbox: Sandbox = False,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """Show the compiled pipeline of SPEC with every option."""
    with reporting(traceback):
        from magiclens.plan.compile import load_plan
        from magiclens.plan.describe import describe_plan
        from magiclens.running.feasible import estimate_text, require_feasible

        plan = load_plan(spec, overrides, sandbox=sandbox)
        needs = require_feasible(plan)
        _print_notices(plan, as_json)
        if why:
            _print_forecast(plan, as_json)
        else:
            print_result(lambda: f"{describe_plan(plan)}\n\n{estimate_text(needs)}", plan.resolved, as_json=as_json)


def _print_notices(plan: Plan, quiet: bool) -> None:
    for notice in () if quiet else plan.notices():
        print_note(f"note: {notice}")


def _print_forecast(plan: Plan, as_json: bool) -> None:
    from magiclens.cache.store import usual_cache
    from magiclens.running.forecast import forecast, whole_run_kept

    cache = usual_cache(print_note)
    steps = forecast(plan, cache)
    whole = cache is not None and whole_run_kept(plan, cache)
    end = "the whole run is kept: its files are copied" if whole else "the rest, such as the report, runs"
    data = {"whole_run_kept": whole, "steps": [vars(step) for step in steps]}
    print_result(lambda: "\n".join([*map(str, steps), "", end]), lambda: data, as_json=as_json)


def _run(
    plan: Plan, executor: Executor, spec: Path, overrides: list[str], folder: Path, observer: Observer
) -> dict[str, Any]:
    """Run a plan, and compile ahead what it needs; its manifest."""
    # not imported for a run that is in the cache: numba takes longer to import than such a run takes
    from magiclens.kernels.spreading import spreading_by
    from magiclens.running.compilation import compiling_ahead
    from magiclens.running.pipeline import write_run

    with (
        executor.spreader() as spreader,
        spreading_by(spreader),
        compiling_ahead(spec, overrides, observer) as watching,
    ):
        if spreader is None and executor.type != "serial":
            raise InputError(
                f"{executor.type!r} makes several lenses side by side, not one; leave it out", "--executor"
            )
        return write_run(plan, folder, watching)


def _summary(folder: Path, manifest: dict[str, Any]) -> str:
    """The verdict, scores of every view as designed, and where the files are."""
    files = [a["path"] for a in manifest["artifacts"] if "/" not in a["path"]]
    lines = []
    if "preflight.json" in files:
        preflight = json.loads((folder / "preflight.json").read_text(encoding="utf-8"))
        lines = [preflight["verdict"]["text"], f"preflight: {preflight['status']}", ""]
    scores = [key for key in manifest["views"][0] if key.startswith(("psnr_db", "ssim"))]
    lines.append(f"{'as designed':16}" + "".join(f"{key:>18}" for key in scores))
    for view in manifest["views"]:
        lines.append(f"{view['name']:16}" + "".join(f"{_score_text(view[key]):>18}" for key in scores))
    return "\n".join([*lines, "", f"{folder}: {', '.join(files)}, manifest.json"])


def _score_text(value: float | None) -> str:
    """A score with as many digits as say something: decibels are above 1, SSIM is not."""
    return "-" if value is None else f"{value:.2f}" if value > 1 else f"{value:.3f}"
