"""The page of a run: one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from markupsafe import Markup

from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import Photograph
from magiclens.pages.templating import render_page
from magiclens.report.tables import (
    errands,
    file_rows,
    headline_rows,
    lens_rows,
    metric_rows,
    option_rows,
    score_rows,
    verdict_of_run,
)


def figure_block(figure: Figure) -> str:
    """The part of the page that shows a figure; everything that users wrote is escaped."""
    return render_page("magiclens.report/figure.html", figure=figure)


def report_page(
    data: RunResult, folder: Path, figures: Sequence[str], photos: Mapping[str, Sequence[Photograph]]
) -> str:
    """The HTML page of a run; everything that users wrote is escaped.

    Args:
        data: The run.
        folder: The run folder, which holds all other files already.
        figures: Blocks of ``figure_block`` in the order of the page, what matters most first.
        photos: Photographs by renderer, one for each view.
    """
    manifest = data.manifest
    return render_page(
        "magiclens.report/report.html",
        manifest=manifest,
        lens=data.scene.lens,
        views=len(data.scene.views),
        figures=[Markup(block) for block in figures],
        verdict=verdict_of_run(folder),
        headlines=headline_rows(data, photos),
        errands=errands(data.scene, data.solid, folder),
        renderers=list(photos),
        scores=score_rows(data.scene, photos),
        metrics=metric_rows(manifest["metrics"]),
        lens_rows=lens_rows(data.scene),
        stages=[(stage, option_rows(stage["options"])) for stage in manifest["stages"]],
        files=file_rows(folder),
    )
