"""The commands that use the lens of a run folder: ``encode``, ``preflight``, ``view``, ``show`` and so on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magiclens.cli.common import AsJson, Quiet, RunFolder, Traceback, print_note, print_result, reporting

if TYPE_CHECKING:
    from magiclens.running.open_run import OpenRun

_ViewName = Annotated[
    str | None, typer.Option("--view", metavar="NAME", help="Through which view's eye; the first by default.")
]
_Open = Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")]
_MachineName = Annotated[
    str | None,
    typer.Option(
        "--machine",
        metavar="NAME",
        help="The lens as this machine makes it of the same mesh.",
    ),
]
_PicturesOut = Annotated[
    Path, typer.Option("--out", "-o", metavar="OUT", help="A PNG, GIF or MP4, or a folder.", show_default=False)
]


def encode_command(
    run_dir: RunFolder,
    pictures: Annotated[
        Path, typer.Argument(metavar="PICTURES", help="A picture, or a folder, GIF or MP4.", show_default=False)
    ],
    out: _PicturesOut,
    view: _ViewName = None,
    machine: _MachineName = None,
    traceback: Traceback = False,
) -> None:
    """Paint the source that shows PICTURES through the universal lens of RUN_DIR, and say how much shows without it."""
    with reporting(traceback):
        from magiclens.analysis.secrecy import secrecy_word
        from magiclens.running.convert import convert_pictures

        lens = _opened(run_dir, machine)
        px_per_mm = len(lens.view(view).source) / lens.plan.lens.source_size_mm
        shown: list[float] = []
        typer.echo(convert_pictures(lambda frames: lens.encode(frames, view, shown.append), pictures, out, px_per_mm))
        print_note(f"without the lens the picture is {secrecy_word(max(shown))}: {max(shown):.2f} of it shows")


def decode_command(
    run_dir: RunFolder,
    sources: Annotated[
        Path, typer.Argument(metavar="SOURCES", help="A source, or a folder, GIF or MP4 of them.", show_default=False)
    ],
    out: _PicturesOut,
    view: _ViewName = None,
    machine: _MachineName = None,
    traceback: Traceback = False,
) -> None:
    """Show what the eye sees through the lens of RUN_DIR when SOURCES lie below it."""
    with reporting(traceback):
        from magiclens.running.convert import convert_pictures

        lens = _opened(run_dir, machine)
        typer.echo(convert_pictures(lambda frames: lens.decode(frames, view), sources, out))


def preflight_command(
    run_dir: RunFolder, quiet: Quiet = False, as_json: AsJson = False, traceback: Traceback = False
) -> None:
    """Check whether the lens of RUN_DIR is fit to be made, and write its preflight.html. Exit code 1: it is not."""
    with reporting(traceback):
        from magiclens.running.open_run import check_run_folder

        found, text = check_run_folder(run_dir)
        page, data = run_dir / "preflight.html", run_dir / "preflight.json"
        print_result(lambda: f"{text}\n{page}", lambda: json.loads(data.read_text(encoding="utf-8")), quiet, as_json)
        if found.status == "red":
            raise typer.Exit(1)


def machined_command(
    run_dir: RunFolder, quiet: Quiet = False, as_json: AsJson = False, traceback: Traceback = False
) -> None:
    """Simulate the milling programs of RUN_DIR: how they fit, and pictures of what their lens shows."""
    with reporting(traceback):
        from dataclasses import asdict

        from magiclens.running.milling_simulation import simulate_milling

        found = simulate_milling(run_dir)
        print_result(found.as_text, lambda: asdict(found), quiet, as_json)


def view_command(
    run_dir: RunFolder,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="The page.", show_default="RUN_DIR/view.html"),
    ] = None,
    show: _Open = True,
    traceback: Traceback = False,
) -> None:
    """Write a page on which the lens of RUN_DIR is moved about on its source, and open it."""
    with reporting(traceback):
        from magiclens.web.viewer import write_view

        _present(write_view(run_dir, out), show)


def show_command(
    run_dir: RunFolder,
    frame: Annotated[
        str | None,
        typer.Argument(metavar="[FRAME]", help="A view or a source, to show that alone.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="The page.", show_default="RUN_DIR/show.html"),
    ] = None,
    show: _Open = True,
    traceback: Traceback = False,
) -> None:
    """Write a page that shows the sources of RUN_DIR at true size on a phone, tablet or projector, and open it."""
    with reporting(traceback):
        from magiclens.web.screen import write_screen

        _present(write_screen(run_dir, frame, out), show)


def _present(page: Path, show: bool) -> None:
    typer.echo(page)
    if show:
        typer.launch(page.absolute().as_uri())


def _opened(run_dir: Path, machine: str | None) -> OpenRun:
    """The lens of a run folder, as its spec or as another machine makes it."""
    from magiclens.running.open_run import open_run

    lens = open_run(run_dir)
    return lens.made_by(machine) if machine else lens
