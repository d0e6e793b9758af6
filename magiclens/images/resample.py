"""Resampling, padding and cropping of pictures in linear light."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray


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


def pixels_touching(mask: BoolArray, shape: tuple[int, int]) -> BoolArray:
    """Pixels of another raster of the same square that touch any pixel of a mask.

    Args:
        mask: (h, w).
        shape: Rows and columns of the other raster.

    Returns:
        (H, W).
    """
    if mask.shape == shape:
        return mask
    counts = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), np.int64)
    counts[1:, 1:] = mask.cumsum(axis=0).cumsum(axis=1)  # of true pixels above and to the left
    (top, bottom), (left, right) = (_span(old, new) for old, new in zip(mask.shape, shape, strict=True))
    below, above = counts[bottom], counts[top]
    touching: BoolArray = below[:, right] - below[:, left] - above[:, right] + above[:, left] > 0
    return touching


def _span(old: int, new: int) -> tuple[IntArray, IntArray]:
    """For each of ``new`` pixels along a side, the first of ``old`` ones that it touches, and one after the last."""
    edges = np.arange(new + 1) * old
    return edges[:-1] // new, -(-edges[1:] // new)


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
    """Exact area means: the sum of old pixels times the shares of a new pixel's height that they cover."""
    from scipy.sparse import csr_array

    old = len(image)
    # in parts of which an old pixel is ``rows`` high and a new one ``old``
    edges = np.union1d(np.arange(old + 1) * rows, np.arange(rows + 1) * old)
    first, share = edges[:-1], np.diff(edges) / old
    shares = csr_array((share, (first // old, first // rows)), shape=(rows, old))
    return np.asarray((shares @ image.reshape(old, -1)).reshape(rows, *image.shape[1:]), np.float32)


def _bicubic(image: FloatArray, rows: int) -> FloatArray:
    """Bicubic enlargement (Keys 1981, a = -0.5)."""
    from PIL import Image

    channels = [Image.fromarray(np.ascontiguousarray(c)) for c in np.moveaxis(image, -1, 0)]
    grown = [c.resize((c.width, rows), Image.Resampling.BICUBIC) for c in channels]
    return np.stack([np.asarray(c, np.float32) for c in grown], axis=-1)
