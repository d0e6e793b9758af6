"""Pictures as data URIs that stay within a number of bytes."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from magiclens.images.files import rgb_picture
from magiclens.pages.pictures import data_uri

if TYPE_CHECKING:
    from PIL.Image import Image

_QUALITIES = (95, 90, 80, 70, 55, 40)
"""Qualities to try, the best first."""
_SHRINK = 0.75
"""Factor of width and height when even the lowest quality is too long."""
_AVIF_SPEED = 8
"""Speed of the AVIF encoder: pictures are nearly as good as at 6, in half the time."""


def picture_uri_within(path: Path, most_bytes: int) -> str:
    """The data URI of a picture: lossless if that fits into so many bytes, else as good and then as large as fits."""
    return next(data_uri(content, kind) for content, kind in _tries(path) if len(content) <= most_bytes)


def thumbnail_uri(path: Path, side: int) -> str:
    """The data URI of a picture, shrunk to (side, side). Raises InputError if it cannot be read."""
    from PIL import Image

    return data_uri(_webp(rgb_picture(path).resize((side, side), Image.Resampling.LANCZOS), 80), "webp")


def _tries(path: Path) -> Iterator[tuple[bytes, str]]:
    """Contents of picture files and their formats, better ones first, down to a single pixel."""
    from PIL import Image

    image = rgb_picture(path)
    yield _webp(image, None), "webp"
    while True:
        yield from (_lossy(image, quality) for quality in _QUALITIES)
        width, height = (max(round(_SHRINK * side), 1) for side in image.size)
        image = image.resize((width, height), Image.Resampling.LANCZOS)


def _lossy(image: Image, quality: int) -> tuple[bytes, str]:
    """AVIF, which keeps the full resolution of colours; WebP if the installed Pillow cannot write AVIF."""
    from PIL import Image as pillow

    pillow.init()
    if "AVIF" not in pillow.SAVE:
        return _webp(image, quality), "webp"
    content = io.BytesIO()
    image.save(content, "AVIF", quality=quality, subsampling="4:4:4", speed=_AVIF_SPEED)
    return content.getvalue(), "avif"


def _webp(image: Image, quality: int | None) -> bytes:
    """The bytes of a WebP file; without a quality it is lossless."""
    content = io.BytesIO()
    image.save(content, "WEBP", lossless=quality is None, quality=quality or 75, method=4)
    return content.getvalue()
