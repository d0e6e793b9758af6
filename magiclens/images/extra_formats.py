"""Picture files that need a package of an extra: drawings (SVG) and photographs of phones (HEIC)."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from magiclens.contract.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image

_SVG_SIDE_PX = 1024
"""Pixels of the longer side of a drawing, which has no pixels of its own."""
_MOST_S, _MOST_BYTES = 0.8, 700_000_000
"""Processor time and memory that a drawing may take, its program included: a kilobyte can ask for hours of work."""
_PATIENCE_S = 60
"""How long to wait for a drawing, however busy the machine, and where processor time cannot be limited."""
_DRAW = """
import sys
side, font, most_s, most_bytes = sys.argv[1:]
try:
    import resource, signal
    resource.setrlimit(resource.RLIMIT_AS, (int(most_bytes), int(most_bytes)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.setitimer(signal.ITIMER_PROF, float(most_s))
except (ImportError, AttributeError, ValueError, OSError):
    pass  # the system has no such limits; somebody waits for this process
import resvg_py
try:
    picture = resvg_py.svg_to_bytes(
        svg_string=sys.stdin.buffer.read().decode("utf-8"),
        width=int(side), height=int(side), skip_system_fonts=True, font_files=[font],
    )
except ValueError as error:
    sys.exit(str(error))
sys.stdout.buffer.write(bytes(picture))
"""
"""The program that draws, in a process of its own: it can be stopped, and may run out of stack without harm."""
_HEIC_BRANDS = (b"heic", b"heix", b"hevc", b"hevx", b"heim", b"heis", b"mif1", b"msf1")
"""What follows ``ftyp`` in a HEIC file (ISO/IEC 23008-12)."""
_OTHER_FILE = re.compile(rb"<(?:\w+:)?(?:image|feImage|use)\b[^>]*?href\s*=\s*[\"']\s*(?!#|data:)", re.IGNORECASE)
"""A part of a drawing that would be read from another file."""


def svg_image(path: str | PathLike[str]) -> Image | None:
    """The picture of an SVG file; None if it is none.

    Its texts are in the font that magiclens has, so that they look the same everywhere.

    Raises:
        InputError: It cannot be drawn, or takes too much time or memory, or names other files; or the package resvg-py
            is missing.
    """
    content = Path(path).read_bytes() if _is_svg(Path(path)) else None
    if content is None:
        return None
    from PIL import Image

    from magiclens.images.text import font_file

    if find_spec("resvg_py") is None:
        raise _missing(path, "an SVG", "svg")
    if _OTHER_FILE.search(content):
        raise InputError(f"{str(path)!r} shows other files; put their pictures into it, or save it as PNG")
    command = [sys.executable, "-P", "-c", _DRAW, str(_SVG_SIDE_PX), str(font_file()), str(_MOST_S), str(_MOST_BYTES)]
    try:
        done = subprocess.run(command, input=content, capture_output=True, timeout=_PATIENCE_S, check=False)
        said, code = done.stderr.decode(errors="replace").strip(), done.returncode
    except subprocess.TimeoutExpired:
        said, code = "", -1
    if code < 0 or (code and "MemoryError" in said):
        most = f"{_MOST_S:g} s or {_MOST_BYTES // 10**6} MB"
        wish = "make it simpler, or save it as PNG"
        raise InputError(f"the drawing {str(path)!r} takes more than {most} to be drawn; {wish}")
    if code:
        raise InputError(f"the drawing {str(path)!r} cannot be read: {said}")
    return Image.open(io.BytesIO(done.stdout), formats=("PNG",))


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
