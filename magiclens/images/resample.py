"""Resampling, padding and cropping of pictures in linear light."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray


def resize(linear: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Resize an image: along an axis that shrinks by exact area means, along one that grows by bicubic interpolation.

    Args:
        linear: (H, W, C) linear light.
        shape: Rows and columns of the result.

    Returns:
        (rows, columns, C) float32, linear light, clipped to 0..1 since bicubic interpolation overshoots.
    """
    out = np.asarray(linear, np.float32)
    for axis in (0, 1):
        out = np.swapaxes(_resize_rows(np.swapaxes(out, 0, axis), shape[axis]), 0, axis)
    return np.ascontiguousarray(np.clip(out, 0.0, 1.0))


def padded_to_square(linear: FloatArray) -> FloatArray:
    """(S, S, C): the image (H, W, C), linear light, centred on white paper whose side is the image's longer one."""
    rows, columns, channels = linear.shape
    side = max(rows, columns)
    if rows == columns:
        return linear
    top, left = (side - rows) // 2, (side - columns) // 2
    paper = np.ones((side, side, channels), linear.dtype)
    paper[top : top + rows, left : left + columns] = linear
    return paper


def cropped_to_square(linear: FloatArray) -> FloatArray:
    """(S, S, C): the central part of an image (H, W, C), whose side is the image's shorter one."""
    rows, columns, _ = linear.shape
    side = min(rows, columns)
    top, left = (rows - side) // 2, (columns - side) // 2
    return linear[top : top + side, left : left + side]


def halved(image: FloatArray) -> FloatArray:
    """(ceil(H / 2), ceil(W / 2), ...) means of 2 x 2 pixels of an (H, W, ...) image.

    If H or W is odd, the last row or column is used twice.
    """
    rows, columns = image.shape[:2]
    even = np.pad(image, ((0, rows % 2), (0, columns % 2), *((0, 0),) * (image.ndim - 2)), mode="edge")
    return np.asarray((even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4, image.dtype)


def _resize_rows(image: FloatArray, rows: int) -> FloatArray:
    """An (H, W, C) image with another number of rows."""
    if rows == len(image):
        return image
    return _box(image, rows) if rows < len(image) else _bicubic(image, rows)


def _box(image: FloatArray, rows: int) -> FloatArray:
    """Exact area means: differences of the running integral at the new pixels' edges."""
    integral = np.zeros((len(image) + 1, *image.shape[1:]))
    np.cumsum(image, axis=0, out=integral[1:])
    edges = np.arange(rows + 1) * len(image) / rows
    below = np.minimum(edges.astype(int), len(image) - 1)
    part = (edges - below)[:, None, None]
    at_edges = integral[below] * (1 - part) + integral[below + 1] * part
    return np.asarray(np.diff(at_edges, axis=0) * rows / len(image), np.float32)


def _bicubic(image: FloatArray, rows: int) -> FloatArray:
    """Bicubic enlargement (Keys 1981, a = -0.5)."""
    from PIL import Image

    channels = [Image.fromarray(np.ascontiguousarray(c)) for c in np.moveaxis(image, -1, 0)]
    grown = [c.resize((c.width, rows), Image.Resampling.BICUBIC) for c in channels]
    return np.stack([np.asarray(c, np.float32) for c in grown], axis=-1)
