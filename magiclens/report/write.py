"""Writes the figures and the page of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from magiclens.analysis.annealed import before_after
from magiclens.analysis.contact import contact_sheet
from magiclens.analysis.differences import error_map
from magiclens.analysis.overlap import overlap_map
from magiclens.analysis.secrecy_figure import secrecy_map
from magiclens.analysis.surface import height_map, step_map
from magiclens.analysis.warp import warp_map
from magiclens.analysis.zone_figures import zone_figures
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import photographs
from magiclens.drawing.tiles import render_rows
from magiclens.report.page import page

if TYPE_CHECKING:
    from PIL.PngImagePlugin import PngInfo


def write_report(data: RunResult, folder: Path) -> None:
    """Write ``figures/*.png`` and ``report.html`` into a run folder; equal runs give equal bytes."""
    scene, seen = data.scene, photographs(data)
    figures = [
        contact_sheet(data, seen),
        *(zone_figures(data, data.zone) if data.zone else []),
        *([warp_map(data)] if data.matched else []),
        *([secrecy_map(data, data.secrecy)] if data.secrecy else []),
        *(error_map(name, photos, scene.views, scene.lens.facets) for name, photos in list(seen.items())[:1]),
        height_map(data.height_field),
        step_map(data.height_field),
        before_after(data),
        overlap_map(data),
    ]
    (folder / "figures").mkdir(exist_ok=True)
    for figure in figures:
        path = folder / "figures" / f"{figure.name}.png"
        render_rows(figure.rows).save(path, "PNG", compress_level=4, pnginfo=_words(figure))
    (folder / "report.html").write_text(page(data, folder, figures, seen), encoding="utf-8")


def _words(figure: Figure) -> PngInfo:
    """Title and caption, which the picture's file keeps."""
    from PIL.PngImagePlugin import PngInfo

    words = PngInfo()
    words.add_itxt("Title", figure.title)
    words.add_itxt("Description", figure.caption)
    return words
