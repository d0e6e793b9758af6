"""Pictures as data URIs that stay within a number of bytes."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image

QUALITIES = (92, 82, 70, 55, 40)
SHRINK = 0.75


def fitting(path: Path, most_bytes: int) -> str:
    """A data URI of the picture, lossless if that fits, else as good and then as large as fits."""
    content = next(made for made in _tries(path) if len(made) <= most_bytes)
    return _uri(content)


def small(path: Path, side: int) -> str:
    """A data URI of the picture at ``side`` pixels, for eyes only."""
    from PIL import Image

    with Image.open(path) as image:
        return _uri(_webp(image.convert("RGB").resize((side, side), Image.Resampling.LANCZOS), 80))


def _tries(path: Path) -> Iterator[bytes]:
    """Contents of WebP files, better ones first, down to a single pixel."""
    from PIL import Image

    with Image.open(path) as opened:
        image = opened.convert("RGB")
    yield _webp(image, None)
    while True:
        yield from (_webp(image, quality) for quality in QUALITIES)
        width, height = (max(round(SHRINK * side), 1) for side in image.size)
        image = image.resize((width, height), Image.Resampling.LANCZOS)


def _webp(image: Image, quality: int | None) -> bytes:
    """The bytes of a WebP file; no quality is lossless."""
    content = io.BytesIO()
    image.save(content, "WEBP", lossless=quality is None, quality=quality or 75, method=4)
    return content.getvalue()


def _uri(content: bytes) -> str:
    return f"data:image/webp;base64,{base64.b64encode(content).decode()}"
