"""Pictures as web pages need them: no larger than shown, and written once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.errors import InputError
from magiclens.drawing.dark import Box, for_dark_pages
from magiclens.running.replacing import atomic_file

if TYPE_CHECKING:
    from PIL.Image import Image

_QUALITY = 72
"""Quality of pictures, 0 to 100."""
_PICTURES = "Pictures"
"""Key in the file of a figure, see ``report.write``."""
_PREVIEW_PX = (1200, 630)
"""Width and height of the picture with which a link to a page is shown elsewhere."""


@dataclass(frozen=True)
class Picture:
    """A picture of the site; ``path`` is relative to the site's folder, width and height are in pixels.

    ``dark`` is the path of the same for dark pages, if it has a look of its own there.
    """

    path: str
    width: int
    height: int
    alt: str
    title: str = ""
    caption: str = ""
    dark: str = ""


class Album:
    """The pictures of the site, all in ``pictures/``; ``paths`` are those that the pages use."""

    def __init__(self, site: Path):
        self._site = site
        self.paths: set[str] = set()

    def shrunk(self, source: Path, group: str, width: int, alt: str) -> Picture:
        """Copy a picture file into the site, as WebP; it is not written again if the file is older than the copy.

        Args:
            source: The file; its own title and description become title and caption.
            group: Folder within ``pictures/``.
            width: Greatest width, pixels.
            alt: Alternative text; the title if it is empty.

        Raises:
            InputError: The file is no picture.
        """
        from PIL import Image

        try:
            with Image.open(source) as image:
                title, caption = (str(image.info.get(key, "")) for key in ("Title", "Description"))
                size = _scaled_down(image.size, width)
                path = self._path(source, group, size[0])
                dark = path.replace(".webp", "-dark.webp") if _PICTURES in image.info else ""
                if not all(_is_newer(self._site / file, source) for file in (path, dark) if file):
                    _write_webp(self._site / path, _resized(image, size))
                    if dark:
                        _write_webp(self._site / dark, _resized(_darkened(image), size))
        except OSError as error:
            raise InputError(f"this is no picture that can be read: {error}", str(source)) from None
        self.paths |= {path, dark} - {""}
        return Picture(path, *size, alt or title, title, caption, dark)

    def preview(self, source: Path, photo: Path, group: str, alt: str) -> Picture:
        """Write a sheet and what is seen of it side by side, as JPEG of the size that previews of links have.

        It is not written again if both files are older than it.
        """
        path = f"pictures/{group}/{photo.parent.name}-{photo.stem}-preview.jpg"
        if not all(_is_newer(self._site / path, file) for file in (source, photo)):
            _write_side_by_side(self._site / path, (source, photo))
        self.paths.add(path)
        return Picture(path, *_PREVIEW_PX, alt)

    def drawn(self, image: Image, group: str, name: str, alt: str) -> Picture:
        """Write a picture that code has drawn into the site."""
        path = f"pictures/{group}/{name}.webp"
        _write_webp(self._site / path, image)
        self.paths.add(path)
        return Picture(path, *image.size, alt)

    def _path(self, source: Path, group: str, width: int) -> str:
        """The name holds the folder, since files in different folders of a run have equal names."""
        return f"pictures/{group}/{source.parent.name}-{source.stem}-{width}.webp"


def _scaled_down(size: tuple[int, int], width: int) -> tuple[int, int]:
    """The size of a picture once it is no wider than ``width``."""
    if size[0] <= width:
        return size
    return width, max(1, round(size[1] * width / size[0]))


def _write_webp(path: Path, image: Image) -> None:
    """Write a picture as WebP, whole or not at all; equal pictures give equal bytes."""
    with atomic_file(path) as partial:
        image.save(partial, "WEBP", quality=_QUALITY, method=4)


def _write_side_by_side(path: Path, files: tuple[Path, Path]) -> None:
    from PIL import Image

    width, height = _PREVIEW_PX
    both = Image.new("RGB", _PREVIEW_PX, "white")
    for k, file in enumerate(files):
        with Image.open(file) as image:
            side = image.convert("RGB").resize((width // 2, width // 2), Image.Resampling.LANCZOS)
        both.paste(side, (k * width // 2, (height - side.height) // 2))
    with atomic_file(path) as partial:
        both.save(partial, "JPEG", quality=_QUALITY)


def _resized(image: Image, size: tuple[int, int]) -> Image:
    from PIL import Image

    return image.convert("RGB").resize(size, Image.Resampling.LANCZOS)


def _darkened(image: Image) -> Image:
    """A figure as it suits dark pages; its file says which parts of it are pictures."""
    from PIL import Image

    boxes: list[Box] = []
    for words in str(image.info[_PICTURES]).split():
        left, upper, right, lower = map(int, words.split(","))
        boxes.append((left, upper, right, lower))
    return Image.fromarray(for_dark_pages(np.asarray(image.convert("RGB")), boxes))


def _is_newer(made: Path, source: Path) -> bool:
    return made.is_file() and made.stat().st_mtime_ns >= source.stat().st_mtime_ns
