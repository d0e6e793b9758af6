"""Pictures as data URIs that stay within a number of bytes."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image

QUALITIES = (95, 90, 80, 70, 55, 40)
SHRINK = 0.75
SPEED = 8
"""Of the AVIF encoder: pictures are nearly as good as at 6, in half the time."""


def fitting(path: Path, most_bytes: int) -> str:
    """A data URI of the picture, lossless if that fits, else as good and then as large as fits."""
    return next(_uri(content, kind) for content, kind in _tries(path) if len(content) <= most_bytes)


def small(path: Path, side: int) -> str:
    """A data URI of the picture at ``side`` pixels, for eyes only."""
    from PIL import Image

    with Image.open(path) as image:
        return _uri(_webp(image.convert("RGB").resize((side, side), Image.Resampling.LANCZOS), 80), "webp")


def _tries(path: Path) -> Iterator[tuple[bytes, str]]:
    """Contents of picture files and their kinds, better ones first, down to a single pixel."""
    from PIL import Image

    with Image.open(path) as opened:
        image = opened.convert("RGB")
    yield _webp(image, None), "webp"
    while True:
        yield from (_lossy(image, quality) for quality in QUALITIES)
        width, height = (max(round(SHRINK * side), 1) for side in image.size)
        image = image.resize((width, height), Image.Resampling.LANCZOS)


def _lossy(image: Image, quality: int) -> tuple[bytes, str]:
    """AVIF, whose colours are as sharp as its greys; WebP if this installation's Pillow cannot write it."""
    from PIL import Image as pillow

    pillow.init()
    if "AVIF" not in pillow.SAVE:
        return _webp(image, quality), "webp"
    content = io.BytesIO()
    image.save(content, "AVIF", quality=quality, subsampling="4:4:4", speed=SPEED)
    return content.getvalue(), "avif"


def _webp(image: Image, quality: int | None) -> bytes:
    """The bytes of a WebP file; no quality is lossless."""
    content = io.BytesIO()
    image.save(content, "WEBP", lossless=quality is None, quality=quality or 75, method=4)
    return content.getvalue()


def _uri(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
