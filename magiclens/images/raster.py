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

    The signed area to the right of every edge is accumulated per pixel and summed along the rows. This is exact but
    for pixels in which outlines overlap partly.

    Args:
        outlines: (n, 2) x and y in pixels, y down, (0, 0) at the top left.
        shape: Rows and columns of the result.
        holes: Whether an outline inside another one that runs the other way round cuts a hole, such as in letters. If
            not, outlines are united, in whatever direction they run.

    Returns:
        (rows, columns) shares 0..1.
    """
    rows, columns = shape
    start, end = _pieces(outlines if holes else [_clockwise(outline) for outline in outlines])
    x = np.clip((start[:, 0] + end[:, 0]) / 2, 0, columns)
    column, row = np.floor(x).astype(int), np.floor((start[:, 1] + end[:, 1]) / 2).astype(int)
    kept = (row >= 0) & (row < rows)
    cell, inside = (row * (columns + 2) + column)[kept], (x - column)[kept]
    down = (end - start)[kept, 1]
    cells = rows * (columns + 2)
    area = np.bincount(cell, down * (1 - inside), cells) + np.bincount(cell + 1, down * inside, cells)
    winding = np.cumsum(area.reshape(rows, columns + 2), axis=1)[:, :columns]
    return np.minimum(np.abs(winding), 1.0)


def _clockwise(outline: FloatArray) -> FloatArray:
    """The outline in clockwise order as seen, so that overlapping outlines add up and never cancel."""
    (x, y), (next_x, next_y) = outline.T, _successors(outline).T
    return outline if float(x @ next_y - y @ next_x) >= 0 else outline[::-1]


def _successors(outline: FloatArray) -> FloatArray:
    """Each point's successor on a closed outline."""
    return np.concatenate([outline[1:], outline[:1]])


def _pieces(outlines: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Starts and ends (n, 2) of the edges of closed outlines, cut so that each piece lies within one pixel."""
    start = np.concatenate(outlines)
    edge = np.concatenate([_successors(outline) for outline in outlines]) - start
    count = np.maximum(np.ceil(np.abs(edge).max(1)), 1).astype(int)
    which = np.repeat(np.arange(len(start)), count)
    step = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    a, b = (start[which] + edge[which] * ((step + k) / count[which])[:, None] for k in (0, 1))
    cuts = np.sort(np.stack([np.zeros(len(a)), *_crossings(a, b), np.ones(len(a))]), axis=0)
    points = a + (b - a) * cuts[..., None]
    return points[:-1].reshape(-1, 2), points[1:].reshape(-1, 2)


def _crossings(a: FloatArray, b: FloatArray) -> FloatArray:
    """(2, n) where edges no longer than a pixel cross a grid line, 0..1 along the edge, in x and in y; 0 if nowhere."""
    line = np.maximum(np.floor(a), np.floor(b))
    crosses = np.floor(a) != np.floor(b)
    return np.where(crosses, (line - a) / np.where(crosses, b - a, 1.0), 0.0).T


def _paint_layer(canvas: FloatArray, layer: Layer) -> None:
    """Paint one layer onto the canvas (S, S, C); only its bounding box is touched."""
    scale = len(canvas) / PICTURE_SIDE
    outlines = [outline * scale for outline in layer.outlines]
    points = np.concatenate(outlines)
    left, top = np.clip(np.floor(points.min(0)), 0, len(canvas)).astype(int)
    right, bottom = np.clip(np.ceil(points.max(0)), 0, len(canvas)).astype(int)
    if left >= right or top >= bottom:
        return
    cover = coverage([outline - (left, top) for outline in outlines], (bottom - top, right - left))
    x, y = np.meshgrid((np.arange(left, right) + 0.5) / scale, (np.arange(top, bottom) + 0.5) / scale)
    share, colour = layer.opacity * cover, layer.paint(x, y)
    for k in range(canvas.shape[-1]):  # numpy is slow along an axis as short as that of channels
        channel = canvas[top:bottom, left:right, k]
        channel += share * (colour[..., k] - channel)
