"""The command line ``mlens``: a table of commands, each in the file of its family.

Starting must be quick, since shells ask for help and completions. So a command's file imports nothing that takes time;
each command imports what it needs when it runs.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from typing import Annotated

import typer

import magiclens
from magiclens.cli import cache, coupon, doctor, lens, many, new, plugins, run, studio

app = typer.Typer(
    name="mlens",
    help="Design magic lenses: clear slabs that reveal a hidden picture in another one.",
    epilog="Exit codes: 0 done; 1 a stage or a plugin failed; 2 the input is wrong.",
    no_args_is_help=True,
    rich_markup_mode=None,  # typer would import rich, which makes --help slow
    pretty_exceptions_enable=False,
)
"""The command line as typer has it."""

_GARBAGE = 100_000
"""New objects after which Python looks for garbage: compilers make many, and nearly all stay."""

COMMANDS: dict[str, Callable[..., None]] = {
    "run": run.run_command,
    "new": new.new_command,
    "check": run.check_command,
    "plan": run.plan_command,
    "plugins": plugins.plugins_command,
    "schema": plugins.schema_command,
    "sweep": many.sweep_command,
    "gallery": many.gallery_command,
    "docs": many.docs_command,
    "encode": lens.encode_command,
    "decode": lens.decode_command,
    "preflight": lens.preflight_command,
    "machined": lens.machined_command,
    "view": lens.view_command,
    "show": lens.show_command,
    "studio": studio.studio_command,
    "coupon": coupon.coupon_command,
    "cache": cache.cache_command,
    "doctor": doctor.doctor_command,
}
"""Every command by its name, in the order of ``mlens --help``."""

for _name, _command in COMMANDS.items():
    app.command(_name)(_command)


@app.callback(invoke_without_command=True)
def _options_of_all_commands(
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
    if disabled:  # in the environment, so that processes that this one starts leave them alone too
        known = os.environ.get("MLENS_DISABLE_PLUGINS", "")
        os.environ["MLENS_DISABLE_PLUGINS"] = ",".join([known, *disabled])


def main() -> None:
    """Run the command line; the entry point of the console script ``mlens``."""
    gc.set_threshold(_GARBAGE)
    # numba words an error for every function that does not fit a call's types, and would colour it
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    try:
        app()
    finally:
        # the process ends, and with it its memory: otherwise Python would look through all objects first, for a second
        gc.freeze()
