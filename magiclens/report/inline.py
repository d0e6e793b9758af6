"""The contact sheet inside a notebook."""

from __future__ import annotations

import io
from html import escape

from magiclens.analysis.contact_sheet import contact_sheet
from magiclens.contract.result import RunResult
from magiclens.drawing.tiles import render_rows
from magiclens.pages.pictures import data_uri

_MOST_WIDTH = 960
"""Greatest width of the picture, pixels."""


def contact_html(data: RunResult) -> str:
    """The contact sheet of a run as a ``<figure>`` with the picture in it; names that users wrote are escaped."""
    figure = contact_sheet(data)
    picture = render_rows(figure.rows)
    if picture.width > _MOST_WIDTH:
        picture = picture.resize((_MOST_WIDTH, picture.height * _MOST_WIDTH // picture.width))
    content = io.BytesIO()
    picture.save(content, "PNG")
    name, caption = escape(data.manifest["name"]), escape(figure.caption)
    image = f'<img src="{data_uri(content.getvalue(), "png")}" alt="{name}: {caption}">'
    return f"<figure>{image}<figcaption>{name}. {caption}</figcaption></figure>"
