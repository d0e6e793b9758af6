"""The run's page: one file that needs nothing else."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from magiclens.report.data import RunData
from magiclens.report.figure import Figure
from magiclens.report.photographs import Photograph
from magiclens.report.scales import Pixels
from magiclens.report.tables import file_rows, headlines, lens_rows, metric_rows, option_rows, score_rows

if TYPE_CHECKING:
    from markupsafe import Markup


def page(data: RunData, folder: Path, figures: Sequence[Figure], seen: Mapping[str, Sequence[Photograph]]) -> str:
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


def look() -> Markup:
    """The style sheet of what all pages have in common."""
    from markupsafe import Markup

    return Markup((files("magiclens.report") / "templates" / "look.css").read_text(encoding="utf-8"))


def embedded(picture: Pixels) -> str:
    """A data URI of a picture (H, W, 3)."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(picture).save(content, "WEBP", quality=82, method=2)
    return f"data:image/webp;base64,{base64.b64encode(content.getvalue()).decode()}"
