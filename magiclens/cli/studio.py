"""The command that serves the studio: ``mlens studio``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from magiclens.cli.common import Traceback, reporting


def studio_command(
    folder: Annotated[
        Path, typer.Option("--folder", metavar="DIR", help="Where pictures, jobs and results are kept.")
    ] = Path("studio"),
    port: Annotated[int, typer.Option("--port", metavar="N", help="Port on 127.0.0.1; 0 for one that is free.")] = 8765,
    origins: Annotated[
        list[str] | None,
        typer.Option(
            "--origin",
            metavar="ORIGIN",
            help="Also https://studio.example.org, for a reverse proxy; again for more.",
            show_default=False,
        ),
    ] = None,
    show: Annotated[bool, typer.Option("--open/--no-open", help="Open it in the browser.")] = True,
    traceback: Traceback = False,
) -> None:
    """Serve a page on this machine on which lenses are designed in the browser, until Ctrl-C."""
    with reporting(traceback):
        from magiclens.config.optional import is_installed
        from magiclens.contract.errors import InputError

        if not (is_installed("starlette") and is_installed("uvicorn")):
            raise InputError("the studio needs two more packages: pip install 'magiclens[studio]'")

        from magiclens.studio.server import serve_studio

        def shown(address: str) -> None:
            typer.echo(f"The studio, until Ctrl-C: {address}")
            if show:
                typer.launch(address)

        serve_studio(folder, port, origins or (), shown)
