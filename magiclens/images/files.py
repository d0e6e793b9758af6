"""Image files: the only place where pixels of a file become linear light, and back."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images.colour import grey, to_display, to_linear

if TYPE_CHECKING:
    from PIL.Image import Image

_SIXTEEN_BIT = ("I", "I;16", "I;16L", "I;16B", "I;16N")
"""Pillow's modes of 16-bit grey pictures; it reads some 16-bit PNGs as 32-bit ``I``."""


def read_image(path: str | PathLike[str]) -> FloatArray:
    """Read an image file; transparent pixels are composited over white paper.

    Returns:
        (H, W, C) float32, linear light; C is 1 if the picture is grey, else 3. Row 0 is the top as a viewer shows it.

    Raises:
        InputError: The file is missing or is not an image.
    """
    light = _over_white(_display_values(_decode(path)))
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


def _decode(path: str | PathLike[str]) -> Image:
    """The file's first picture, upright, its pixels loaded."""
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            return ImageOps.exif_transpose(image)
    except FileNotFoundError:
        raise InputError(f"there is no image file {str(path)!r}") from None
    except IsADirectoryError:
        raise InputError(f"{str(path)!r} is a folder, not an image file") from None
    except UnidentifiedImageError:
        raise InputError(f"{str(path)!r} is not an image file that can be read; use PNG, JPEG, TIFF or GIF") from None
    except Exception as error:  # decoders raise anything on broken files, down to struct.error and SyntaxError
        raise InputError(f"the image file {str(path)!r} cannot be read: {error}") from error


def _display_values(image: Image) -> FloatArray:
    """(H, W, C) float32 display values 0..1, the last channel alpha when C = 2 or 4."""
    if image.mode in _SIXTEEN_BIT:
        return np.asarray(image, np.float32)[..., None] / np.float32(65535)
    mode = "RGBA" if image.has_transparency_data else "L" if image.mode in ("1", "L") else "RGB"
    values = np.asarray(image.convert(mode), np.float32) / np.float32(255)
    return np.atleast_3d(values)


def _over_white(values: FloatArray) -> FloatArray:
    """Linear light of display values; alpha mixes light, so it acts after the sRGB curve."""
    if values.shape[-1] in (1, 3):
        return to_linear(values)
    alpha = values[..., -1:]
    return to_linear(values[..., :-1]) * alpha + (1 - alpha)
