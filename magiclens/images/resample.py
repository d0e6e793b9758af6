"""Resampling in linear light."""

from __future__ import annotations

import numpy as np

from magiclens.images.colour import FloatArray


def resize(linear: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """(rows, columns, C) float32 of an (H, W, C) image in linear light, within 0..1.

    Along an axis that shrinks, every new pixel is the exact mean over its area; along one that grows, bicubic.
    """
    out = np.asarray(linear, np.float32)
    for axis in (0, 1):
        out = np.swapaxes(_resize_rows(np.swapaxes(out, 0, axis), shape[axis]), 0, axis)
    return np.ascontiguousarray(np.clip(out, 0.0, 1.0))


def square(linear: FloatArray) -> FloatArray:
    """(S, S, C): the image centred on white paper as large as its longer side."""
    rows, columns, channels = linear.shape
    side = max(rows, columns)
    if rows == columns:
        return linear
    top, left = (side - rows) // 2, (side - columns) // 2
    paper = np.ones((side, side, channels), linear.dtype)
    paper[top : top + rows, left : left + columns] = linear
    return paper


def middle(linear: FloatArray) -> FloatArray:
    """(S, S, C): the middle of an image (H, W, C), as large as its shorter side."""
    rows, columns, _ = linear.shape
    side = min(rows, columns)
    top, left = (rows - side) // 2, (columns - side) // 2
    return linear[top : top + side, left : left + side]


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
    """Bicubic (Keys, a = -0.5) enlargement; it overshoots at edges."""
    from PIL import Image

    channels = [Image.fromarray(np.ascontiguousarray(c)) for c in np.moveaxis(image, -1, 0)]
    grown = [c.resize((c.width, rows), Image.Resampling.BICUBIC) for c in channels]
    return np.stack([np.asarray(c, np.float32) for c in grown], axis=-1)
