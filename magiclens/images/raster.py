"""Rasterising layers by exact area coverage, in linear light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.vector import PICTURE_SIDE, Layer


def rasterize(layers: Sequence[Layer], size_px: int, paper: Sequence[float] = (1.0,)) -> FloatArray:
    """Draw layers on plain paper, with anti-aliased edges.

    Args:
        layers: What is drawn, the lowest first.
        size_px: Side of the picture.
        paper: Linear light of the paper, C values.

    Returns:
        (size_px, size_px, C) float32, linear light.
    """
    canvas = np.empty((size_px, size_px, len(paper)), np.float32)
    canvas[:] = paper
    for layer in layers:
        _paint_layer(canvas, layer)
    return canvas


def coverage(outlines: Sequence[FloatArray], shape: tuple[int, int], holes: bool = False) -> FloatArray:
    """The share of each pixel's area that is inside closed outlines.

    This is exact but for pixels in which outlines overlap partly.

    Args:
        outlines: (n, 2) x and y in pixels, y down, (0, 0) at the top left.
        shape: Rows and columns of the result.
        holes: Whether an outline inside another one that runs the other way round cuts a hole, such as in letters. If
            not, outlines are united, in whatever direction they run.

    Returns:
        (rows, columns) shares 0..1.
    """
    from magiclens.images.raster_kernels import cover_pixels

    rows, columns = shape
    firsts = np.cumsum([0, *(len(outline) for outline in outlines)])
    cover = np.zeros((rows, columns + 2))
    cover_pixels(np.concatenate(outlines).astype(np.float64), firsts, holes, cover)
    return cover[:, :columns]


def _paint_layer(canvas: FloatArray, layer: Layer) -> None:
    """Paint one layer onto the canvas (S, S, C); only pixels that it covers are touched."""
    from magiclens.images.raster_kernels import find_covered, mix_colours

    scale = len(canvas) / PICTURE_SIDE
    outlines = [outline * scale for outline in layer.outlines]
    points = np.concatenate(outlines)
    left, top = np.clip(np.floor(points.min(0)), 0, len(canvas)).astype(int)
    right, bottom = np.clip(np.ceil(points.max(0)), 0, len(canvas)).astype(int)
    if left >= right or top >= bottom:
        return
    cover = coverage([outline - (left, top) for outline in outlines], (bottom - top, right - left))
    x, y = np.empty((2, np.count_nonzero(cover)))
    find_covered(cover, x, y)
    colours = np.ascontiguousarray(layer.paint((x + left) / scale, (y + top) / scale))
    mix_colours(canvas[top:bottom, left:right], cover, layer.opacity, colours)
