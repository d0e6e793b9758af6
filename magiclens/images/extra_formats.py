"""Picture files that need a package of an extra: drawings (SVG) and photographs of phones (HEIC)."""

from __future__ import annotations

import io
import re
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from magiclens.contract.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image

_SVG_SIDE_PX = 1024
"""Pixels of the longer side of a drawing, which has no pixels of its own."""
_HEIC_BRANDS = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1")
"""What follows ``ftyp`` in a HEIC file (ISO/IEC 23008-12)."""
_OTHER_FILE = re.compile(rb"<(?:\w+:)?(?:image|feImage|use)\b[^>]*?href\s*=\s*[\"']\s*(?!#|data:)", re.IGNORECASE)
"""A part of a drawing that would be read from another file."""


def svg_image(path: str | PathLike[str]) -> Image | None:
    """The picture of an SVG file; None if it is none.

    Its texts are in the font that magiclens has, so that they look the same everywhere.

    Raises:
        InputError: It cannot be drawn, names other files, or the package resvg-py is missing.
    """
    content = Path(path).read_bytes() if _is_svg(Path(path)) else None
    if content is None:
        return None
    from PIL import Image

    from magiclens.images.text import font_file

    try:
        import resvg_py
    except ImportError:
        raise _missing(path, "an SVG", "svg") from None
    if _OTHER_FILE.search(content):
        raise InputError(f"{str(path)!r} shows other files; put their pictures into it, or save it as PNG")
    try:
        png = resvg_py.svg_to_bytes(
            svg_string=content.decode("utf-8"),
            width=_SVG_SIDE_PX,
            height=_SVG_SIDE_PX,
            skip_system_fonts=True,
            font_files=[str(font_file())],
        )
    except ValueError as error:
        raise InputError(f"the drawing {str(path)!r} cannot be read: {error}") from None
    return Image.open(io.BytesIO(bytes(png)), formats=("PNG",))


def heic_format(path: str | PathLike[str]) -> tuple[str, ...]:
    """Pillow's name of the format if a file is HEIC, once Pillow can read it; empty for all others.

    Raises:
        InputError: The package pillow-heif is missing.
    """
    with open(path, "rb") as file:
        start = file.read(12)
    if start[4:8] != b"ftyp" or start[8:12] not in _HEIC_BRANDS:
        return ()
    try:
        import pillow_heif
    except ImportError:
        raise _missing(path, "a HEIC picture", "heic") from None
    pillow_heif.register_heif_opener()
    return ("HEIF",)


def _is_svg(path: Path) -> bool:
    with path.open("rb") as file:
        return path.suffix.lower() == ".svg" or file.read(4) == b"<svg"


def _missing(path: str | PathLike[str], what: str, extra: str) -> InputError:
    return InputError(f"{str(path)!r} is {what}: pip install 'magiclens[{extra}]', or save it as PNG")
