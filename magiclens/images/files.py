"""Image files: the only place where pixels of a file become linear light, and back."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.contract.errors import InputError
from magiclens.images.colour import grey, luminance, to_display, to_linear
from magiclens.images.extra_formats import heic_format, svg_image

if TYPE_CHECKING:
    from PIL.Image import Image

FORMATS = ("PNG", "JPEG", "TIFF", "GIF", "WEBP", "BMP", "PPM")
"""Formats that are read, by Pillow's names. It knows more, some of which start other programs, such as EPS."""
MOST_PIXELS_VARIABLE = "MLENS_MOST_PIXELS"
"""The variable of the environment that allows larger pictures."""
_MOST_PIXELS = 50_000_000
"""The most pixels of a picture, once it is padded to a square; some hundred megabytes in memory."""
_MOST_COUNTED = 100
"""Pages of a TIFF that are counted."""
LEAST_PX = 32
"""Least longer side of a picture that a lens can show or lie on."""
_ONE_OF_MANY = "save the one that is meant as PNG, or make all of them frames of a universal-animation"
"""What to do with a file of several pictures where one is wanted."""
_SHOWS = 0.1
"""Difference of display values from the paper from which a pixel shows on it."""
_LEAST_SHOWN = 0.005
"""Share of a picture's opaque pixels that must show on white paper; below it, the picture lies on black."""
_INTEGERS = ("I", "I;16", "I;16L", "I;16B", "I;16N")
"""Pillow's modes of grey pictures of more than 8 bits; it reads some 16-bit PNGs as 32-bit ``I``."""
_BITS_PER_SAMPLE, _SAMPLE_FORMAT = 258, 339
"""TIFF's tags; sample format 1 is unsigned."""


def read_image(path: str | PathLike[str]) -> FloatArray:
    """Read an image file; what is transparent shows white paper, or black where white would hide the picture.

    Values of 8, 16 and 32 bits, and floats from 0 to 1, are display values (sRGB).

    Returns:
        (H, W, C) float32, linear light; C is 1 if the picture is grey, else 3. Row 0 is the top as a viewer shows it.

    Raises:
        InputError: The file is missing, is not an image, holds several pictures, or is too large.
    """
    light = _over_paper(_values_of(path))
    return np.ascontiguousarray(grey(light), dtype=np.float32)


def lies_on_black(path: str | PathLike[str]) -> bool:
    """Whether ``read_image`` lays a picture that is transparent in places on black. Raises InputError like it."""
    return _hidden_by_white(_values_of(path))


def rgb_picture(path: str | PathLike[str]) -> Image:
    """The picture of a file as Pillow has it, in 8-bit colours. Raises InputError like ``read_image``."""
    return _decode(path)[0].convert("RGB")


def check_not_tiny(picture: FloatArray, path: str | PathLike[str]) -> None:
    """Raise InputError for a picture (H, W, C), read from a file, that has next to no detail to show."""
    rows, columns = picture.shape[:2]
    if max(rows, columns) < LEAST_PX:
        few = f"it has {columns} x {rows} pixels, too few to show anything: the longer side needs {LEAST_PX}"
        raise InputError(few, str(path))


def _values_of(path: str | PathLike[str]) -> FloatArray:
    """(H, W, C) float32 display values of a file, the last channel alpha when C = 2 or 4."""
    picture, tags = _decode(path)
    try:
        return _display_values(picture, tags)
    except InputError as error:
        raise InputError(f"the image file {str(path)!r} cannot be read: {error}") from None


def write_png(path: str | PathLike[str], linear: FloatArray, px_per_mm: float | None = None) -> None:
    """Write an 8-bit sRGB PNG; equal pixels give equal bytes.

    Args:
        path: The file.
        linear: (H, W, C) linear light.
        px_per_mm: Resolution that the file states, so that programs print it true to scale.
    """
    from PIL import Image

    values = np.rint(to_display(grey(linear)) * 255).astype(np.uint8)
    image = Image.fromarray(values[..., 0] if values.shape[-1] == 1 else values)
    image.save(path, format="PNG", compress_level=6, dpi=px_per_mm and (px_per_mm * 25.4,) * 2)


def _decode(path: str | PathLike[str]) -> tuple[Image, Mapping[int, Any]]:
    """The file's picture, upright, its pixels loaded; and its tags, if it is a TIFF."""
    from PIL import ImageOps, UnidentifiedImageError

    try:
        # what decoders warn about is either no harm, or makes them fail soon
        with warnings.catch_warnings(action="ignore"), open_picture(path) as image:
            count = _count(image)
            if count > 1:
                most = " or more" if count == _MOST_COUNTED else ""
                raise InputError(f"{str(path)!r} holds {count}{most} pictures; {_ONE_OF_MANY}")
            return ImageOps.exif_transpose(image), dict(getattr(image, "tag_v2", {}))
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{str(path)!r} is not an image file that can be read; use PNG, JPEG, TIFF or GIF") from None
    except Exception as error:  # decoders raise anything on broken files, down to struct.error and SyntaxError
        raise InputError(f"the image file {str(path)!r} cannot be read: {error}") from error


def _count(image: Image) -> int:
    """How many pictures a file holds that a user may mean; those of a TIFF are counted up to a limit."""
    if image.format in ("JPEG", "MPO"):  # phones put a depth map or a small copy behind a JPEG
        return 1
    if image.format != "TIFF":
        return getattr(image, "n_frames", 1)
    found = 1
    with suppress(EOFError):
        # Pillow's own count looks through all pages for each page
        while found < _MOST_COUNTED:
            image.seek(found)
            found += 1
    image.seek(0)
    return found


def open_picture(path: str | PathLike[str]) -> Image:
    """Open a picture of an allowed format and size; its pixels are not read yet.

    Raises:
        InputError: The file is missing, is no ordinary file, or has too many pixels.
        PIL.UnidentifiedImageError: It is not a picture of an allowed format.
    """
    from PIL import Image

    check_ordinary(path, "image file")
    image = svg_image(path) or Image.open(path, formats=(*FORMATS, *heic_format(path)))
    check_pixels(image.size, str(path))
    return image


def check_ordinary(path: str | PathLike[str], what: str) -> None:
    """Raise InputError unless there is an ordinary file: reading from a pipe might never end."""
    if Path(path).is_dir():
        raise InputError(f"{str(path)!r} is a folder, not an {what}")
    if not Path(path).exists():
        raise InputError(f"there is no {what} {str(path)!r}")
    if not Path(path).is_file():
        raise InputError(f"{str(path)!r} is not an ordinary file")


def check_pixels(size: tuple[int, int], name: str) -> None:
    """Raise InputError for a picture that would take too much memory, padded to a square as all are."""
    most, square = int(os.environ.get(MOST_PIXELS_VARIABLE, _MOST_PIXELS)), max(size) ** 2
    if square > most:
        raise InputError(
            f"{name!r} has {size[0]} x {size[1]} pixels, a square of {square / 1e6:.0f} million; "
            f"at most {most / 1e6:.0f} million are read: make it smaller, or set {MOST_PIXELS_VARIABLE}"
        )


def _display_values(image: Image, tags: Mapping[int, Any]) -> FloatArray:
    """(H, W, C) float32 display values 0..1, the last channel alpha when C = 2 or 4."""
    if image.mode in _INTEGERS:
        return _integers(np.asarray(image), tags)[..., None]
    if image.mode == "F":
        values = np.asarray(image, np.float32)[..., None]
        if not ((values >= 0) & (values <= 1)).all():  # nor NaN
            raise InputError("it holds floats beyond 0 to 1; save it with 16 bits per channel")
        return values
    mode = "RGBA" if image.has_transparency_data else "L" if image.mode in ("1", "L") else "RGB"
    values = np.asarray(image.convert(mode), np.float32) / np.float32(255)
    return np.atleast_3d(values)


def _integers(values: IntArray, tags: Mapping[int, Any]) -> FloatArray:
    """Display values of grey pixels of 16 or 32 bits."""
    if tags.get(_SAMPLE_FORMAT, (1,))[0] != 1:
        raise InputError("it holds numbers with a sign; save it with 16 bits per channel")
    if tags.get(_BITS_PER_SAMPLE, (16,))[0] == 32:
        # Pillow reads them as signed
        return (values.view(np.uint32) / (2**32 - 1)).astype(np.float32)
    return values.astype(np.float32) / np.float32(65535)


def _over_paper(values: FloatArray) -> FloatArray:
    """Linear light of display values; alpha mixes light, so it acts after the sRGB curve."""
    if values.shape[-1] in (1, 3):
        return to_linear(values)
    alpha, paper = values[..., -1:], 0.0 if _hidden_by_white(values) else 1.0
    return to_linear(values[..., :-1]) * alpha + (1 - alpha) * np.float32(paper)


def _hidden_by_white(values: FloatArray) -> bool:
    """Whether nearly all that is opaque in a picture is as light as white paper: a white logo on nothing."""
    if values.shape[-1] in (1, 3):
        return False
    opaque = values[..., -1] > 0.5
    shades = to_display(luminance(to_linear(values[..., :-1])))[opaque]
    return bool(len(shades) and not opaque.all() and (shades < 1 - _SHOWS).mean() < _LEAST_SHOWN)
