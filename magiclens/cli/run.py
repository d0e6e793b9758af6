"""The commands that read a spec: ``mlens run``, ``mlens check`` and ``mlens plan``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magiclens.cli.common import (
    AsJson,
    Overrides,
    Quiet,
    SpecFile,
    Traceback,
    print_result,
    reporting,
)

if TYPE_CHECKING:
    from magiclens.running.pipeline import Run


def run_command(
    spec: SpecFile,
    overrides: Overrides,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The run folder.", show_default="out/NAME")
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """Design the lens of SPEC and write a run folder: mesh, source, simulated photographs, manifest."""
    with reporting(traceback):
        from magiclens.running.compilation import compiling_ahead
        from magiclens.running.observers import Observer, terminal_observer
        from magiclens.running.pipeline import run_spec
        from magiclens.running.termination import end_on_sigterm

        end_on_sigterm()
        # progress goes to standard error, so that standard output holds the result alone
        observer = Observer() if quiet or as_json else terminal_observer(sys.stderr)
        with compiling_ahead(spec, overrides, observer) as observer:
            done = run_spec(spec, out, overrides, observer)
        print_result(lambda: _summary(done), lambda: {"folder": str(done.folder), **done.manifest}, quiet, as_json)


def check_command(
    spec: SpecFile, overrides: Overrides, quiet: Quiet = False, as_json: AsJson = False, traceback: Traceback = False
) -> None:
    """Check SPEC without running it."""
    with reporting(traceback):
        from magiclens.plan.compile import load_plan

        plan = load_plan(spec, overrides)
        scenario, views = plan.scenario.type, [shot.name for shot in plan.shots()]
        data = {"spec": str(spec), "name": plan.spec.name, "scenario": scenario, "views": views}
        print_result(lambda: f"{spec}: ok, {scenario}, views: {', '.join(views)}", lambda: data, quiet, as_json)


def plan_command(spec: SpecFile, overrides: Overrides, as_json: AsJson = False, traceback: Traceback = False) -> None:
    """Show the compiled pipeline of SPEC with every option."""
    with reporting(traceback):
        from magiclens.plan.compile import load_plan
        from magiclens.plan.describe import describe_plan

        plan = load_plan(spec, overrides)
        print_result(lambda: describe_plan(plan), plan.resolved, as_json=as_json)


def _summary(done: Run) -> str:
    """Scores of every view, and where the files are."""
    scores = [key for key in done.manifest["views"][0] if key.startswith(("psnr_db", "ssim"))]
    lines = [f"{'view':16}" + "".join(f"{key:>18}" for key in scores)]
    for view in done.manifest["views"]:
        lines.append(f"{view['name']:16}" + "".join(f"{_score_text(view[key]):>18}" for key in scores))
    files = [a["path"] for a in done.manifest["artifacts"] if "/" not in a["path"]]
    if "preflight.json" in files:
        preflight = json.loads((done.folder / "preflight.json").read_text(encoding="utf-8"))
        lines += ["", f"preflight: {preflight['status']}"]
    return "\n".join([*lines, "", f"{done.folder}: {', '.join(files)}, manifest.json"])


def _score_text(value: float | None) -> str:
    """A score with as many digits as say something: decibels are above 1, SSIM is not."""
    return "-" if value is None else f"{value:.2f}" if value > 1 else f"{value:.3f}"
