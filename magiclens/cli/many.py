"""The commands that make many lenses, with an executor, or many pages: ``mlens sweep``, ``gallery`` and ``docs``."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from magiclens.cli.common import (
    AsJson,
    ExecutorName,
    ExecutorSettings,
    Quiet,
    Sandbox,
    SpecFile,
    Traceback,
    chosen_executor,
    print_no_note,
    print_note,
    print_result,
    reporting,
)

_SweptSettings = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUES",
        default_factory=list,
        show_default=False,
        help="Values to try, such as lens.facets=16,32,64; again for more keys. [a, b] is one value.",
    ),
]


_GalleryList = Annotated[Path, typer.Argument(metavar="[LIST]", help="The gallery's list, a YAML file.")]
_LIST = Path("gallery", "gallery.yaml")


def sweep_command(
    spec: SpecFile,
    settings: _SweptSettings,
    executor_settings: ExecutorSettings,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The sweep's folder.", show_default="out/NAME-sweep")
    ] = None,
    executor: ExecutorName = "serial",
    sandbox: Sandbox = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """Run SPEC with every combination of some values, and compare them on one sheet.

    Combinations that are finished are not run again. Exit code 1: some failed, the sheet says why.
    """
    with reporting(traceback):
        from magiclens.running.termination import end_on_sigterm
        from magiclens.sweep.sweeping import sweep_spec
        from magiclens.sweep.table import sweep_data, sweep_text

        end_on_sigterm()
        worker, registry = chosen_executor(executor, executor_settings)
        say = print_no_note if quiet or as_json else print_note
        done = sweep_spec(spec, settings, out, worker, registry, say, sandbox)
        print_result(lambda: sweep_text(done), lambda: sweep_data(done), quiet, as_json)
        if done.failed:
            raise typer.Exit(1)


def gallery_command(
    executor_settings: ExecutorSettings,
    listed: _GalleryList = _LIST,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The site's folder.")] = Path("out", "gallery"),
    small: Annotated[bool, typer.Option("--quick", help="Smaller lenses, as the list says.")] = False,
    published: Annotated[
        Path | None,
        typer.Option(
            "--publish",
            metavar="DIR",
            help="Also a copy for a web host such as GitHub Pages, in a folder of its own.",
            show_default=False,
        ),
    ] = None,
    executor: ExecutorName = "processes",
    quiet: Quiet = False,
    traceback: Traceback = False,
) -> None:
    """Build a static site of all lenses on LIST, with the documentation. What is up to date is not made again."""
    with reporting(traceback):
        from magiclens.running.termination import end_on_sigterm
        from magiclens.web.gallery.build import build_gallery
        from magiclens.web.gallery.gallery_list import load_gallery
        from magiclens.web.gallery.publish import check_place, publish_gallery

        if published:
            check_place(published)
        end_on_sigterm()
        worker, registry = chosen_executor(executor, executor_settings)
        say = print_no_note if quiet else print_note
        build_gallery(load_gallery(listed), out, worker, registry, _all_commands(), small, say)
        if published:
            publish_gallery(out, published)


def docs_command(
    listed: _GalleryList = _LIST,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The site's folder.")] = Path("out", "docs"),
    quiet: Quiet = False,
    traceback: Traceback = False,
) -> None:
    """Build the documentation on LIST alone as a static site, in seconds; no lens is made."""
    with reporting(traceback):
        from magiclens.plan.registry import Registry
        from magiclens.web.gallery.build import build_docs
        from magiclens.web.gallery.gallery_list import load_gallery

        build_docs(load_gallery(listed), out, Registry.load(), _all_commands(), print_no_note if quiet else print_note)


def _all_commands() -> dict[str, Any]:
    """All commands, as typer has built them: the reference of a site documents them."""
    table = import_module("magiclens.cli").app  # which imports this file
    commands: dict[str, Any] = vars(typer.main.get_command(table))["commands"]
    return commands
