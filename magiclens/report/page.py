"""The run's page: one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import Photograph
from magiclens.pages.base import embedded, look
from magiclens.report.tables import file_rows, headlines, lens_rows, metric_rows, option_rows, score_rows


def page(data: RunResult, folder: Path, figures: Sequence[Figure], seen: Mapping[str, Sequence[Photograph]]) -> str:
    """The HTML page of a run whose other files are in ``folder``. Everything that users wrote is escaped."""
    from jinja2 import Environment, StrictUndefined

    source = (files("magiclens.report") / "templates" / "report.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    facts = data.manifest
    environment.filters["embedded"] = embedded
    return environment.from_string(source).render(
        look=look(),
        facts=facts,
        lens=data.scene.lens,
        views=len(data.scene.views),
        figures=figures,
        headlines=headlines(data, seen),
        renderers=list(seen),
        scores=score_rows(data.scene, seen),
        metrics=metric_rows(facts["metrics"]),
        lens_rows=lens_rows(data.scene),
        stages=[(stage, option_rows(stage["options"])) for stage in facts["stages"]],
        files=file_rows(folder),
    )
