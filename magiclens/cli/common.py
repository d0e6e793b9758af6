"""What commands of the command line share: their options, how they print a result, and how they report an error."""

from __future__ import annotations

import json
import signal
import traceback as tracebacks
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from magiclens.contract.errors import MagicLensError

if TYPE_CHECKING:
    from magiclens.contract.executors import Executor
    from magiclens.plan.registry import Registry

SpecFile = Annotated[Path, typer.Argument(metavar="SPEC", help="The spec, a YAML file.", show_default=False)]
"""The argument of commands that read a spec."""

RunFolder = Annotated[Path, typer.Argument(metavar="RUN_DIR", help="A finished run folder.", show_default=False)]
"""The argument of commands that read a run folder."""

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
"""The option that changes values of the spec."""

Sandbox = Annotated[
    bool, typer.Option("--sandbox", help="Refuse files outside of the spec's folder, also behind links.")
]
"""The option for specs that somebody else has written."""

Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing; the exit code says it.")]
"""The option that turns output off."""

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")]
"""The option that prints for programs."""

Traceback = Annotated[bool, typer.Option("--traceback", help="Show where in the program an error came from.")]
"""The option that helps to report a bug."""


def _executors(incomplete: str) -> list[str]:
    """Names of executors, for shells that complete what is typed."""
    from magiclens.plan.registry import EXECUTOR, Registry

    return [name for name in Registry.load().types(EXECUTOR) if name.startswith(incomplete)]


ExecutorName = Annotated[
    str,
    typer.Option(
        "--executor",
        metavar="NAME",
        help="Who does the work: serial, processes, or a plugin's.",
        autocompletion=_executors,
    ),
]
"""The option that picks the executor of a command that makes many lenses."""

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
"""The option that sets the executor's own options."""


def chosen_executor(name: str, settings: list[str]) -> tuple[Executor, Registry]:
    """The executor that the options ask for, and the registry that it was found in."""
    from magiclens.plan.registry import Registry
    from magiclens.running.jobs import choose_executor

    registry = Registry.load()
    return choose_executor(name, settings, registry), registry


@contextmanager
def reporting(traceback: bool) -> Iterator[None]:
    """Turn the errors of a command into one line on standard error and an exit code."""
    try:
        yield
    except MagicLensError as error:
        _fail(str(error), error.exit_code, traceback)
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}", 1, traceback)
    except KeyboardInterrupt:
        _fail("interrupted", 128 + signal.SIGINT, traceback)  # as shells count it


def _fail(message: str, code: int, traceback: bool) -> NoReturn:
    if traceback:
        tracebacks.print_exc()
    typer.echo(f"error: {message}", err=True)
    raise typer.Exit(code)


def print_result(text: Callable[[], Any], data: Callable[[], Any], quiet: bool = False, as_json: bool = False) -> None:
    """Print a result as text, as JSON, or not at all.

    Args:
        text: Makes what people read. It is called only if that is printed.
        data: Makes what programs read: dicts, lists, text and finite numbers.
        quiet: Print nothing, unless ``as_json``.
        as_json: Print ``data`` and nothing else.
    """
    if as_json:
        # NaN is not JSON, and most readers of JSON fail on it
        typer.echo(json.dumps(data(), indent=2, allow_nan=False))
    elif not quiet:
        typer.echo(text())


def print_note(text: str) -> None:
    """Print a line about the progress of the work, which is no part of the result, to standard error."""
    typer.echo(text, err=True)


def print_no_note(_: str) -> None:
    """Stand in for ``print_note`` where nothing is to be printed."""
