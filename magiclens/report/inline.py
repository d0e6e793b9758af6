"""The contact sheet inside a notebook."""

from __future__ import annotations

import base64
import io
from html import escape

from magiclens.analysis.contact_sheet import contact_sheet
from magiclens.contract.result import RunResult
from magiclens.drawing.tiles import render_rows

WIDEST = 960
"""Pixels."""


def contact_html(data: RunResult) -> str:
    """A figure whose picture is within it; names that users wrote are escaped."""
    figure = contact_sheet(data)
    picture = render_rows(figure.rows)
    if picture.width > WIDEST:
        picture = picture.resize((WIDEST, picture.height * WIDEST // picture.width))
    content = io.BytesIO()
    picture.save(content, "PNG")
    name, uri = escape(data.manifest["name"]), base64.b64encode(content.getvalue()).decode()
    image = f'<img src="data:image/png;base64,{uri}" alt="{name}: {escape(figure.caption)}">'
    return f"<figure>{image}<figcaption>{name}. {escape(figure.caption)}</figcaption></figure>"
