"""The contact sheet: per view what lies below the lens, what shall be seen, and what is seen."""

from __future__ import annotations

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import Lens, View
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import photographs
from magiclens.drawing.scales import Pixels
from magiclens.drawing.tiles import side_of_tiles, titled_rows, to_pixels

MARK = (232, 89, 12)
"""Orange of the mark on the lens."""


def contact_sheet(result: RunResult) -> Figure:
    """One row per view: source, target and every renderer's photograph with its scores."""
    views, seen = result.scene.views, photographs(result)
    side = side_of_tiles(len(views))
    sources = {view.source_name: to_pixels(view.source, side) for view in views}
    turned = any(view.quarter_turns for view in views)
    titles = ["Source", "Target", *(f"Through the lens ({name})" for name in seen)]
    rows = []
    for k, view in enumerate(views):
        source = sources[view.source_name]
        pictures = [marked(source, result.scene.lens, view) if turned else source, to_pixels(view.target, side)]
        pictures += [to_pixels(photos[k].picture, side) for photos in seen.values()]
        placement = view_placement(view, result.scene.lens, turned)
        captions = [placement, view.name, *(photos[k].caption for photos in seen.values())]
        rows.append(list(zip(pictures, captions, strict=True)))
    mark = " The orange corner of the lens shows how it is turned." if turned else ""
    caption = f"One view in each row: what lies under the lens, what it shall show, what simulated cameras see.{mark}"
    return Figure("contact-sheet", "What the lens shows", titled_rows(titles, rows), caption)


def view_placement(view: View, lens: Lens, turned: bool) -> str:
    """How the lens and the eye are placed in a view."""
    x, y, z = view.eye_mm
    parts = [f"lens at {view.rotation_deg:g}°"] if turned else []
    if abs(x) + abs(y) > 0.5:
        parts.append(f"eye at ({round(x)}, {round(y)}) mm")
    return ", ".join(parts) or f"eye {z - lens.thickness_mm:.0f} mm above the lens"


def marked(source: Pixels, lens: Lens, view: View) -> Pixels:
    """The source (S, S, 3) with the lens's outline, and a mark on the corner that is its top left when unturned."""
    side = len(source)
    at = (np.arange(side) + 0.5) / side - 0.5
    half, corner = 0.5 * lens.size_mm / lens.source_size_mm, 0.065 * lens.size_mm / lens.source_size_mm
    x, y = at[None, :] + half, at[:, None] + half
    inside = (abs(at[None, :]) < half) & (abs(at[:, None]) < half)
    rim = inside & (np.maximum(abs(at[None, :]), abs(at[:, None])) > half - 2.5 / side)
    mark = inside & (x + y < 2 * corner)
    out = source.copy()
    out[rim | np.rot90(mark, view.quarter_turns)] = MARK
    return out


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    return [contact_sheet(result)]


CONTACT_SHEET = Analysis("contact-sheet", figures=_figures)
"""What every view shows."""
