"""The page for screens as HTML."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from markupsafe import Markup

from magiclens.analysis.contact_sheet import view_placement
from magiclens.config.suggest import unknown
from magiclens.contract.errors import InputError
from magiclens.exporting.print_page import Page, pages
from magiclens.pages.pictures import data_uri
from magiclens.pages.templating import render_page, template_text
from magiclens.running.manifest import source_path
from magiclens.running.open_run import OpenRun, open_run
from magiclens.web.embedding import json_for_script, write_beside

CARD_MM = (53.98, 85.60)
"""Width and height of a bank card that stands upright (ISO/IEC 7810 ID-1)."""
_SIDES = ("top", "left", "bottom", "right")
"""The side of the sheet to which the lens's upper edge points, by quarter turns of the lens."""


def screen_page(run_dir: Path, frame: str | None = None) -> str:
    """The page with the sources of a finished run.

    Args:
        run_dir: The run folder.
        frame: The view or the source that is shown, the only one then; all by default.

    Raises:
        InputError: It is no run folder, has no such view or source, or its lens has no grid.
    """
    lens = open_run(run_dir)
    data = {
        "card": CARD_MM,
        "size": lens.plan.lens.source_size_mm,
        "frames": [_frame(lens, page) for page in _chosen(pages(lens.scene, lens.solid), frame)],
    }
    return render_page(
        "magiclens.web.screen/screen.html",
        name=lens.files.manifest["name"],
        data=Markup(json_for_script(data)),
        script=Markup(template_text("magiclens.web.screen/screen.js")),
    )


def write_screen(run_dir: Path, frame: str | None = None, out: Path | None = None) -> Path:
    """Write the page, whole or not at all; ``show.html`` in the run folder by default.

    Raises:
        InputError: As ``screen_page``, or ``out`` is a folder.
    """
    return write_beside(run_dir, out or run_dir / "show.html", lambda: screen_page(run_dir, frame))


def _chosen(every: list[Page], frame: str | None) -> list[Page]:
    """All pages, or the one of a view or a source."""
    named = {name: page for page in every for name in (*(view.name for view in page.views), _source(page))}
    if frame is not None and frame not in named:
        raise InputError(unknown("frame", frame, named), "FRAME")
    return every if frame is None else [named[frame]]


def _source(page: Page) -> str:
    return page.views[0].source_name


def _frame(lens: OpenRun, page: Page) -> dict[str, Any]:
    """A source, the outline of the lens on it, mm from its middle, and how the views want the lens and the eye."""
    turned = any(view.quarter_turns for view in page.views)
    sides: dict[str, list[str]] = {}
    for view in page.views:
        sides.setdefault(_SIDES[view.quarter_turns], []).append(view.name)
    up = {side: f"upper edge here: {', '.join(names)}" for side, names in sides.items()}
    path = lens.files.file(source_path(page.views[0]))
    return {
        "name": _source(page),
        "picture": data_uri(path.read_bytes(), "png"),
        "outlines": page.outlines,
        "up": up if turned else {"top": "this edge up"},
        "views": [f"{view.name}: {view_placement(view, lens.plan.lens, turned)}" for view in page.views],
    }
