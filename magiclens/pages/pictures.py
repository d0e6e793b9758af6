"""Pictures inside a page, as data URIs."""

from __future__ import annotations

import base64
import io

from magiclens.drawing.scales import Pixels


def data_uri(content: bytes, kind: str) -> str:
    """The data URI of a picture file; ``kind`` is its format as in ``image/webp``."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def webp_uri(picture: Pixels) -> str:
    """The data URI of a picture (H, W, 3) as WebP."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(picture).save(content, "WEBP", quality=66, method=2)
    return data_uri(content.getvalue(), "webp")
