"""The style sheet and the embedded pictures of every page."""

from __future__ import annotations

import base64
import io
from importlib.resources import files
from typing import TYPE_CHECKING

from magiclens.drawing.scales import Pixels

if TYPE_CHECKING:
    from markupsafe import Markup


def look() -> Markup:
    """The style sheet of what all pages have in common."""
    from markupsafe import Markup

    return Markup((files("magiclens.pages") / "templates" / "look.css").read_text(encoding="utf-8"))


def embedded(picture: Pixels) -> str:
    """A data URI of a picture (H, W, 3)."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(picture).save(content, "WEBP", quality=82, method=2)
    return f"data:image/webp;base64,{base64.b64encode(content.getvalue()).decode()}"
