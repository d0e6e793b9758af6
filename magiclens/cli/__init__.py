"""The command line: thin, and quick to say what it can do. What takes time to import waits for its command."""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback as tracebacks
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

import magiclens
from magiclens.contract.errors import MagicLensError, Terminated

if TYPE_CHECKING:
    from magiclens.running.pipeline import Run

app = typer.Typer(
    name="mlens",
    help="Design magic lenses: clear slabs that reveal a hidden picture in another one.",
    epilog="Exit codes: 0 done; 1 a stage or a plugin failed; 2 the input is wrong.",
    no_args_is_help=True,
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
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing; the exit code says it.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")]
Traceback = Annotated[bool, typer.Option("--traceback", help="Show where in the program an error came from.")]


def _scenarios(incomplete: str) -> list[str]:
    """For shells that complete what is typed."""
    from magiclens.new.layouts import LAYOUTS

    return [name for name in LAYOUTS if name.startswith(incomplete)]


def _executors(incomplete: str) -> list[str]:
    """For shells that complete what is typed."""
    from magiclens.plan.registry import EXECUTOR, Registry

    return [name for name in Registry.load().types(EXECUTOR) if name.startswith(incomplete)]


@app.callback(invoke_without_command=True)
def _top(
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
    disabled: Annotated[
        list[str] | None,
        typer.Option(
            "--disable-plugin",
            metavar="NAME",
            help="Leave a plugin alone, by package or entry point name; again for more. Or set MLENS_DISABLE_PLUGINS.",
            show_default=False,
        ),
    ] = None,
) -> None:
    if version:
        typer.echo(magiclens.__version__)
        raise typer.Exit
    if disabled:  # in the environment, so that processes of ours leave them alone too
        known = os.environ.get("MLENS_DISABLE_PLUGINS", "")
        os.environ["MLENS_DISABLE_PLUGINS"] = ",".join([known, *disabled])


@app.command()
def run(
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
    with _reporting(traceback):
        from magiclens.running.observers import Observer, terminal_observer
        from magiclens.running.pipeline import run_spec

        signal.signal(signal.SIGTERM, _terminated)
        done = run_spec(spec, out, overrides, Observer() if quiet or as_json else terminal_observer(sys.stderr))
        _say(lambda: _summary(done), lambda: {"folder": str(done.folder), **done.manifest}, quiet, as_json)


@app.command()
def new(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO", help="single, rotating, ...", show_default=False, autocompletion=_scenarios
        ),
    ],
    pictures: Annotated[
        list[Path], typer.Argument(metavar="PICTURES", help="What the lens shall show.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="SPEC", help="The spec to write.", show_default=False)],
    source: Annotated[
        Path | None, typer.Option("--source", metavar="PICTURE", help="What lies below the lens, instead of discs.")
    ] = None,
    questions: Annotated[
        list[str] | None,
        typer.Option("--question", metavar="TEXT", help="For question-answer: one per picture.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
    traceback: Traceback = False,
) -> None:
    """Write a commented spec for your own PICTURES, with contrast, polarity, window and facets that suit them."""
    with _reporting(traceback):
        from magiclens.new.write import new_spec

        new_spec(scenario, pictures, out, source, questions or (), force)
        typer.echo(f"{out}: written. Read it, change what you like, then: mlens run {out}")


@app.command()
def check(
    spec: SpecFile, overrides: Overrides, quiet: Quiet = False, as_json: AsJson = False, traceback: Traceback = False
) -> None:
    """Check SPEC without running it."""
    with _reporting(traceback):
        from magiclens.plan.compile import load_plan

        plan = load_plan(spec, overrides)
        scenario, views = plan.scenario.type, [shot.name for shot in plan.shots()]
        facts = {"spec": str(spec), "name": plan.spec.name, "scenario": scenario, "views": views}
        _say(lambda: f"{spec}: ok, {scenario}, views: {', '.join(views)}", lambda: facts, quiet, as_json)


@app.command()
def plan(spec: SpecFile, overrides: Overrides, as_json: AsJson = False, traceback: Traceback = False) -> None:
    """Show the compiled pipeline of SPEC with every option."""
    with _reporting(traceback):
        from magiclens.plan.compile import describe, load_plan

        found = load_plan(spec, overrides)
        _say(lambda: describe(found), found.resolved, as_json=as_json)


@app.command()
def plugins(as_json: AsJson = False) -> None:
    """List every stage, scenario and picture that is installed, and plugins that failed to load."""
    with _reporting(False):
        from magiclens.plan.listing import describe_plugins, plugin_facts
        from magiclens.plan.registry import Registry

        registry = Registry.load()
        _say(lambda: describe_plugins(registry), lambda: plugin_facts(registry), as_json=as_json)


@app.command()
def schema() -> None:
    """Print the JSON Schema (draft 7) of specs, for editors."""
    with _reporting(False):
        from magiclens.config.schema import json_schema
        from magiclens.contract.stages import KINDS
        from magiclens.plan.registry import ART, SCENARIO, STAGE, Registry

        registry = Registry.load()
        stages = {kind: registry.classes(STAGE, kind) for kind in KINDS}
        typer.echo(json.dumps(json_schema(registry.classes(SCENARIO), stages, registry.types(ART)), indent=2))


Settings = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUES",
        default_factory=list,
        show_default=False,
        help="Values to try, such as lens.facets=16,32,64; again for more keys. [a, b] is one value.",
    ),
]
ExecutorName = Annotated[
    str,
    typer.Option(
        "--executor",
        metavar="NAME",
        help="Who does the work: serial, processes, or a plugin's.",
        autocompletion=_executors,
    ),
]
ExecutorSettings = Annotated[
    list[str],
    typer.Option(
        "--executor-set",
        metavar="KEY=VALUE",
        default_factory=list,
        show_default=False,
        help="An option of the executor, such as workers=2; again for more.",
    ),
]



@app.command()
def sweep(
    spec: SpecFile,
    settings: Settings,
    executor_settings: ExecutorSettings,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The sweep's folder.", show_default="out/NAME-sweep")
    ] = None,
    executor: ExecutorName = "serial",
    quiet: Quiet = False,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """Run SPEC with every combination of some values, and compare them on one sheet.

    Combinations that are finished are not run again. Exit code 1: some failed, the sheet says why.
    """
    with _reporting(traceback):
        from magiclens.plan.registry import Registry
        from magiclens.running.jobs import choose_executor
        from magiclens.sweep.sweeping import sweep_spec
        from magiclens.sweep.table import as_text, facts

        signal.signal(signal.SIGTERM, _terminated)
        registry = Registry.load()
        worker = choose_executor(executor, executor_settings, registry)
        say = (lambda _: None) if quiet or as_json else _note
        done = sweep_spec(spec, settings, out, worker, registry, say)
        _say(lambda: as_text(done), lambda: facts(done), quiet, as_json)
        if done.failed:
            raise typer.Exit(1)


@app.command()
def gallery(
    executor_settings: ExecutorSettings,
    listed: Annotated[
        Path, typer.Argument(metavar="[LIST]", help="The gallery's list, a YAML file.")
    ] = Path("gallery", "gallery.yaml"),
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The site's folder.")] = Path("out", "gallery"),
    small: Annotated[bool, typer.Option("--quick", help="Smaller lenses, as the list says.")] = False,
    executor: ExecutorName = "processes",
    quiet: Quiet = False,
    traceback: Traceback = False,
) -> None:
    """Build a static site of all lenses on LIST, with the documentation. What is up to date is not made again."""
    with _reporting(traceback):
        from magiclens.plan.registry import Registry
        from magiclens.running.jobs import choose_executor
        from magiclens.web.gallery.build import build_gallery

        signal.signal(signal.SIGTERM, _terminated)
        registry = Registry.load()
        worker = choose_executor(executor, executor_settings, registry)
        commands = vars(typer.main.get_command(app))["commands"]
        build_gallery(listed, out, worker, registry, commands, small, (lambda _: None) if quiet else _note)


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
        from magiclens.images.convert import convert
        from magiclens.running.open_run import open_run

        lens = open_run(run_dir)
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
        from magiclens.images.convert import convert
        from magiclens.running.open_run import open_run

        lens = open_run(run_dir)
        typer.echo(convert(lambda frames: lens.decode(frames, view), sources, out))


@app.command()
def preflight(
    run_dir: RunFolder, quiet: Quiet = False, as_json: AsJson = False, traceback: Traceback = False
) -> None:
    """Check whether the lens of RUN_DIR is fit to be made, and write its preflight.html. Exit code 1: it is not."""
    with _reporting(traceback):
        from magiclens.running.open_run import check_run_folder

        found, text = check_run_folder(run_dir)
        facts = run_dir / "preflight.json"
        _say(lambda: f"{text}\n{run_dir / 'preflight.html'}", lambda: json.loads(facts.read_text()), quiet, as_json)
        if found.status == "red":
            raise typer.Exit(1)


@app.command()
def machined(
    run_dir: RunFolder, quiet: Quiet = False, as_json: AsJson = False, traceback: Traceback = False
) -> None:
    """Simulate the milling programs of RUN_DIR: how they fit, and pictures of what their lens shows."""
    with _reporting(traceback):
        from dataclasses import asdict

        from magiclens.running.machined import as_text
        from magiclens.running.machined import machined as run_programs

        found = run_programs(run_dir)
        _say(lambda: as_text(found), lambda: asdict(found), quiet, as_json)


@app.command()
def view(
    run_dir: RunFolder,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="The page.", show_default="RUN_DIR/view.html"),
    ] = None,
    show: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
    traceback: Traceback = False,
) -> None:
    """Write a page on which the lens of RUN_DIR is moved about on its source, and open it."""
    with _reporting(traceback):
        from magiclens.web.viewer import write_view

        path = write_view(run_dir, out)
        typer.echo(path)
        if show:
            typer.launch(path.absolute().as_uri())


@app.command()
def doctor(as_json: AsJson = False) -> None:
    """Look for all that magiclens can use, and say how to get what is missing. Exit code 1: it cannot work."""
    with _reporting(False):
        from magiclens.cli.doctor import as_facts, as_text, examine, unfit

        found = examine()
        _say(lambda: as_text(found), lambda: as_facts(found), as_json=as_json)
        if unfit(found):
            raise typer.Exit(1)


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


def _say(text: Callable[[], Any], facts: Callable[[], Any], quiet: bool = False, as_json: bool = False) -> None:
    """Print a result for people, for programs, or not at all."""
    if as_json:
        typer.echo(json.dumps(facts(), indent=2, allow_nan=False))
    elif not quiet:
        typer.echo(text())


def _note(text: str) -> None:
    typer.echo(text, err=True)


def _terminated(*_: Any) -> NoReturn:
    """End as an exception does, so that the unfinished run folder is removed."""
    raise Terminated(143)


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
