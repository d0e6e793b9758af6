"""Writes the figures and the page of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magiclens.contract.artifacts import Scene
from magiclens.drawing.figure import Figure
from magiclens.drawing.tiles import picture_boxes, render_rows
from magiclens.images.score import ScoresByRenderer
from magiclens.kernels.threads import side_by_side
from magiclens.report.page import figure_block, report_page

if TYPE_CHECKING:
    from PIL.PngImagePlugin import PngInfo


def write_figure(figure: Figure, folder: Path) -> str:
    """Write ``figures/<name>.png`` into a run folder; the figure as a block of the page."""
    (folder / "figures").mkdir(exist_ok=True)
    path = folder / "figures" / f"{figure.name}.png"

    def save() -> str:
        render_rows(figure.rows).save(path, "PNG", compress_level=3, pnginfo=_words(figure))
        return ""

    # the block's pictures are WebP, whose encoder leaves the interpreter to others
    works: list[Callable[[], str]] = [partial(figure_block, figure), save]
    return side_by_side(lambda work: work(), works)[0]


def write_report(
    scene: Scene, manifest: Mapping[str, Any], figures: Sequence[str], scores: ScoresByRenderer, folder: Path
) -> None:
    """Write ``report.html`` into a run folder; equal runs give equal bytes.

    Args:
        scene: The lens and its views.
        manifest: Complete but for timings and files.
        figures: What ``write_figure`` returned, in the order of the page.
        scores: Of every renderer, one score per view.
        folder: The run folder.
    """
    (folder / "report.html").write_text(report_page(scene, manifest, folder, figures, scores), encoding="utf-8")


def _words(figure: Figure) -> PngInfo:
    """Title and caption, which the picture's file keeps, and which parts of it are pictures, for dark pages."""
    from PIL.PngImagePlugin import PngInfo

    words = PngInfo()
    words.add_itxt("Title", figure.title)
    words.add_itxt("Description", figure.caption)
    words.add_text("Pictures", " ".join(",".join(map(str, box)) for box in picture_boxes(figure.rows)))
    return words
