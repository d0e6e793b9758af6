"""The command that writes a spec for a user's own pictures: ``mlens new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from magiclens.cli.common import Traceback, reporting


def _scenarios(incomplete: str) -> list[str]:
    """Types of scenarios, for shells that complete what is typed."""
    from magiclens.new.layouts import LAYOUTS

    return [name for name in LAYOUTS if name.startswith(incomplete)]


def new_command(
    scenario: Annotated[
        str,
        typer.Argument(metavar="SCENARIO", help="single, rotating, ...", show_default=False, autocompletion=_scenarios),
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
    machine: Annotated[
        str | None,
        typer.Option(
            "--machine", metavar="NAME", help="What makes the lens: sla, lcd-12k, milling, ...", show_default=False
        ),
    ] = None,
    size: Annotated[str, typer.Option("--size", metavar="LENGTH", help="Side of the lens, such as 60mm.")] = "100mm",
    place: Annotated[
        str, typer.Option("--for", metavar="PLACE", help="table, hand or wall: in the latter two, facets are wider.")
    ] = "table",
    crop: Annotated[
        str, typer.Option("--crop", metavar="HOW", help="auto, centre (cut to the middle square) or fit (on white).")
    ] = "auto",
    traceback: Traceback = False,
) -> None:
    """Write a commented spec for your own PICTURES, with contrast, polarity, window and facets that suit them."""
    with reporting(traceback):
        from magiclens.new.write import Making, new_spec, treatment_of

        new_spec(scenario, pictures, out, source, questions or (), Making(machine, size, place), treatment_of(crop))
        typer.echo(f"{out}: written. Read it, change what you like, then: mlens run {out}")
