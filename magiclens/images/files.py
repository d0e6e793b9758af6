"""Image files: the only place where pixels of a file become linear light, and back."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.contract.errors import InputError
from magiclens.images.colour import grey, to_display, to_linear

if TYPE_CHECKING:
    from PIL.Image import Image

FORMATS = ("PNG", "JPEG", "TIFF", "GIF", "WEBP", "BMP", "PPM")
"""Formats that are read, by Pillow's names. It knows more, some of which start other programs, such as EPS."""
MOST_PIXELS_VARIABLE = "MLENS_MOST_PIXELS"
"""The variable of the environment that allows larger pictures."""
_MOST_PIXELS = 50_000_000
"""The most pixels of a picture, once it is padded to a square; some hundred megabytes in memory."""
_INTEGERS = ("I", "I;16", "I;16L", "I;16B", "I;16N")
"""Pillow's modes of grey pictures of more than 8 bits; it reads some 16-bit PNGs as 32-bit ``I``."""
_BITS_PER_SAMPLE, _SAMPLE_FORMAT = 258, 339
"""TIFF's tags; sample format 1 is unsigned."""


def read_image(path: str | PathLike[str]) -> FloatArray:
    """Read an image file; transparent pixels are composited over white paper.

    Values of 8, 16 and 32 bits, and floats from 0 to 1, are display values (sRGB).

    Returns:
        (H, W, C) float32, linear light; C is 1 if the picture is grey, else 3. Row 0 is the top as a viewer shows it.

    Raises:
        InputError: The file is missing, is not an image, holds several pictures, or is too large.
    """
    picture, tags = _decode(path)
    try:
        light = _over_white(_display_values(picture, tags))
    except InputError as error:
        raise InputError(f"the image file {str(path)!r} cannot be read: {error}") from None
    return np.ascontiguousarray(grey(light), dtype=np.float32)


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
        with open_picture(path) as image:
            # phones put a depth map or a small copy behind a JPEG
            count = getattr(image, "n_frames", 1) if image.format not in ("JPEG", "MPO") else 1
            if count > 1:
                raise InputError(f"{str(path)!r} holds {count} pictures; save the one that is meant as PNG")
            return ImageOps.exif_transpose(image), dict(getattr(image, "tag_v2", {}))
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"{str(path)!r} is not an image file that can be read; use PNG, JPEG, TIFF or GIF") from None
    except Exception as error:  # decoders raise anything on broken files, down to struct.error and SyntaxError
        raise InputError(f"the image file {str(path)!r} cannot be read: {error}") from error


def open_picture(path: str | PathLike[str]) -> Image:
    """Open a picture of an allowed format and size; its pixels are not read yet.

    Raises:
        InputError: The file is missing, is no ordinary file, or has too many pixels.
        PIL.UnidentifiedImageError: It is not a picture of an allowed format.
    """
    from PIL import Image

    check_ordinary(path, "image file")
    image = Image.open(path, formats=FORMATS)
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


def _over_white(values: FloatArray) -> FloatArray:
    """Linear light of display values; alpha mixes light, so it acts after the sRGB curve."""
    if values.shape[-1] in (1, 3):
        return to_linear(values)
    alpha = values[..., -1:]
    return to_linear(values[..., :-1]) * alpha + (1 - alpha)
