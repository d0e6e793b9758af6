"""A closed body under a grid of points, manifold by construction: the grid on top, sides, a flat bottom."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Solid


def border(rows: int, columns: int) -> IntArray:
    """(B,) indices of a grid's border points, counter-clockwise as the viewer sees them."""
    index = np.arange(rows * columns).reshape(rows, columns)
    return np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])


def slab(top: FloatArray, floor: FloatArray, eye_mm: FloatArray | None = None) -> Solid:
    """The body under a top (rows, columns, 3) whose border stands on the points ``floor`` (B, 3) of z = 0, mm.

    Every cell is cut from its top-left to its bottom-right corner; the bottom is a fan about the floor's mean. eye_mm:
    along whose rays the top's cells are cut; None if they are vertical.
    """
    rows, columns = top.shape[:2]
    vertices = np.concatenate([top.reshape(-1, 3), floor, floor.mean(axis=0, keepdims=True)])
    faces = np.concatenate([_top_faces(rows, columns), _faces_below(border(rows, columns), rows * columns)])
    return Solid(vertices, faces.astype(np.int32), (rows, columns), eye_mm)


def slab_under(x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray, floor_mm: float = 0.0) -> Solid:
    """The body under heights (rows, columns) above every (x_mm[column], y_mm[row]), with vertical cells.

    Its floor is the top's outline, or a square of the side ``floor_mm`` where that is larger.
    """
    top = np.stack([*np.meshgrid(x_mm, y_mm), z_mm], axis=-1)
    rim = top.reshape(-1, 3)[border(*z_mm.shape)]
    half = np.abs(rim[:, :2]).max(axis=0)
    return slab(top, rim * (*np.maximum(floor_mm / 2 / half, 1.0), 0.0))


def _top_faces(rows: int, columns: int) -> IntArray:
    index = np.arange(rows * columns).reshape(rows, columns)
    tl, tr, bl, br = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    return np.stack([tl, bl, br, tl, br, tr], axis=-1).reshape(-1, 3)


def _faces_below(rim: IntArray, first: int) -> IntArray:
    """Two triangles between each border edge and the floor edge below, whose points start at ``first``; the floor."""
    low = first + np.arange(len(rim))
    a, b, c, d = rim, np.roll(rim, -1), low, np.roll(low, -1)
    middle = np.full_like(low, first + len(rim))
    sides = [np.stack([a, c, d], axis=-1), np.stack([a, d, b], axis=-1)]
    return np.concatenate([*sides, np.stack([low, middle, d], axis=-1)])
