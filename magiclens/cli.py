"""The command line: thin, and quick to say what it can do. What takes time to import waits for its command."""

from __future__ import annotations

import json
import signal
import sys
import traceback as tracebacks
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

import magiclens
from magiclens.errors import MagicLensError

if TYPE_CHECKING:
    from magiclens.run import Run

app = typer.Typer(
    name="mlens",
    help="Design magic lenses: clear slabs that reveal a hidden picture in another one.",
    epilog="Exit codes: 0 done; 1 a stage or a plugin failed; 2 the input is wrong.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

SpecFile = Annotated[Path, typer.Argument(metavar="SPEC", help="The spec, a YAML file.", show_default=False)]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        default_factory=list,
        show_default=False,
        help="Change a value, such as lens.facets=64 or scenario.targets.0.art=bat; again for more.",
    ),
]
Traceback = Annotated[bool, typer.Option("--traceback", help="Show where in the program an error came from.")]


@app.callback(invoke_without_command=True)
def _top(version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False) -> None:
    if version:
        typer.echo(magiclens.__version__)
        raise typer.Exit


@app.command()
def run(
    spec: SpecFile,
    overrides: Overrides,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The run folder.", show_default="out/NAME")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show neither progress nor summary.")] = False,
    traceback: Traceback = False,
) -> None:
    """Design the lens of SPEC and write a run folder: mesh, source, simulated photographs, manifest."""
    with _reporting(traceback):
        from magiclens.observers import Observer, watching
        from magiclens.run import run_spec

        signal.signal(signal.SIGTERM, _terminated)
        done = run_spec(spec, out, overrides, Observer() if quiet else watching(sys.stderr))
        if not quiet:
            typer.echo(_summary(done))


@app.command()
def check(spec: SpecFile, overrides: Overrides, traceback: Traceback = False) -> None:
    """Check SPEC without running it."""
    with _reporting(traceback):
        from magiclens.plan import load_plan

        plan = load_plan(spec, overrides)
        shots = plan.scenario.shots(plan.lens, plan.spec.viewer)
        typer.echo(f"{spec}: ok, {plan.scenario.type}, views: {', '.join(shot.name for shot in shots)}")


@app.command()
def plan(spec: SpecFile, overrides: Overrides, traceback: Traceback = False) -> None:
    """Show the compiled pipeline of SPEC with every option."""
    with _reporting(traceback):
        from magiclens.plan import describe, load_plan

        typer.echo(describe(load_plan(spec, overrides)))


@app.command()
def plugins() -> None:
    """List every stage, scenario and picture that is installed, and plugins that failed to load."""
    from magiclens.listing import describe_plugins
    from magiclens.registry import Registry

    typer.echo(describe_plugins(Registry.load()))


@app.command()
def schema() -> None:
    """Print the JSON Schema (draft 7) of specs, for editors."""
    from magiclens.registry import ART, SCENARIO, STAGE, Registry
    from magiclens.spec.schema import json_schema
    from magiclens.stages import KINDS

    registry = Registry.load()
    stages = {kind: registry.classes(STAGE, kind) for kind in KINDS}
    typer.echo(json.dumps(json_schema(registry.classes(SCENARIO), stages, registry.types(ART)), indent=2))


RunFolder = Annotated[Path, typer.Argument(metavar="RUN_DIR", help="A finished run folder.", show_default=False)]
Seen = Annotated[
    str | None, typer.Option("--view", metavar="NAME", help="Through which view's eye; the first by default.")
]


@app.command()
def encode(
    run_dir: RunFolder,
    pictures: Annotated[
        Path, typer.Argument(metavar="PICTURES", help="A picture, or a folder, GIF or MP4.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="OUT", help="A PNG, GIF or MP4, or a folder.", show_default=False)
    ],
    view: Seen = None,
    traceback: Traceback = False,
) -> None:
    """Paint the source that shows PICTURES through the universal lens of RUN_DIR."""
    with _reporting(traceback):
        from magiclens.frames import convert
        from magiclens.reopen import reopen

        lens = reopen(run_dir)
        scale = len(lens.view(view).source) / lens.plan.lens.source_size_mm
        typer.echo(convert(lambda frames: lens.encode(frames, view), pictures, out, scale))


@app.command()
def decode(
    run_dir: RunFolder,
    sources: Annotated[
        Path, typer.Argument(metavar="SOURCES", help="A source, or a folder, GIF or MP4 of them.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="OUT", help="A PNG, GIF or MP4, or a folder.", show_default=False)
    ],
    view: Seen = None,
    traceback: Traceback = False,
) -> None:
    """Show what the eye sees through the lens of RUN_DIR when SOURCES lie below it."""
    with _reporting(traceback):
        from magiclens.frames import convert
        from magiclens.reopen import reopen

        lens = reopen(run_dir)
        typer.echo(convert(lambda frames: lens.decode(frames, view), sources, out))


@app.command()
def preflight(run_dir: RunFolder, traceback: Traceback = False) -> None:
    """Check whether the lens of RUN_DIR is fit to be made, and write its preflight.html. Exit code 1: it is not."""
    with _reporting(traceback):
        from magiclens.reopen import preflight as check_run

        found, text = check_run(run_dir)
        typer.echo(f"{text}\n{run_dir / 'preflight.html'}")
        if found.status == "red":
            raise typer.Exit(1)


@app.command()
def machined(run_dir: RunFolder, traceback: Traceback = False) -> None:
    """Simulate the milling programs of RUN_DIR: how they fit, and pictures of what their lens shows."""
    with _reporting(traceback):
        from magiclens.machined import machined as run_programs

        typer.echo(run_programs(run_dir))


@contextmanager
def _reporting(traceback: bool) -> Iterator[None]:
    """Turn errors into one message and an exit code."""
    try:
        yield
    except MagicLensError as error:
        _fail(str(error), error.exit_code, traceback)
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror}", 1, traceback)
    except KeyboardInterrupt:
        _fail("interrupted", 130, traceback)


def _fail(message: str, code: int, traceback: bool) -> NoReturn:
    if traceback:
        tracebacks.print_exc()
    typer.echo(f"error: {message}", err=True)
    raise typer.Exit(code)


def _terminated(*_: Any) -> NoReturn:
    """End as an exception does, so that the unfinished run folder is removed."""
    raise SystemExit(143)


def _summary(done: Run) -> str:
    """Scores per view, and where the files are."""
    scores = [key for key in done.manifest["views"][0] if key.startswith(("psnr_db", "ssim"))]
    lines = [f"{'view':16}" + "".join(f"{key:>18}" for key in scores)]
    for view in done.manifest["views"]:
        lines.append(f"{view['name']:16}" + "".join(f"{_figure(view[key]):>18}" for key in scores))
    files = [a["path"] for a in done.manifest["artifacts"] if "/" not in a["path"]]
    if "preflight.json" in files:
        found = json.loads((done.folder / "preflight.json").read_text(encoding="utf-8"))
        lines += ["", f"preflight: {found['status']}"]
    return "\n".join([*lines, "", f"{done.folder}: {', '.join(files)}, manifest.json"])


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}" if value > 1 else f"{value:.3f}"


def main() -> None:
    """The console script."""
    app()
