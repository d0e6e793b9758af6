"""The page of a run: one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from magiclens.contract.artifacts import Scene
from magiclens.drawing.figure import Figure
from magiclens.images.score import ScoresByRenderer
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
    scene: Scene, manifest: Mapping[str, Any], folder: Path, figures: Sequence[str], scores: ScoresByRenderer
) -> str:
    """The HTML page of a run; everything that users wrote is escaped.

    Args:
        scene: The lens and its views.
        manifest: Complete but for timings and files.
        folder: The run folder, which holds all other files already.
        figures: Blocks of ``figure_block`` in the order of the page, what matters most first.
        scores: Of every renderer, one score per view.
    """
    return render_page(
        "magiclens.report/report.html",
        manifest=manifest,
        lens=scene.lens,
        views=len(scene.views),
        figures=[Markup(block) for block in figures],
        verdict=verdict_of_run(folder),
        headlines=headline_rows(manifest["metrics"], scores),
        errands=errands(scene, manifest["metrics"], folder),
        renderers=list(scores),
        scores=score_rows(scene, scores),
        metrics=metric_rows(manifest["metrics"]),
        lens_rows=lens_rows(scene),
        stages=[(stage, option_rows(stage["options"])) for stage in manifest["stages"]],
        files=file_rows(folder),
    )
