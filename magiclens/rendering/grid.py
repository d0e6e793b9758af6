"""The top of a solid as a height field over the reference plane, in coordinates in which its cells are upright.

Cells cut along eye rays become upright under the projective map (x, y, z) -> (u, v, w): (u, v) is where the line from
the cutting eye through the point meets the reference plane, and w = D / (eye_z - z), D the eye's distance from that
plane. The map keeps lines straight and planes flat, so rays and triangles may be intersected in (u, v, w)
exactly as in space. Vertical cells need no map: (u, v, w) = (x, y, z).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid
from magiclens.contract.errors import InputError


@dataclass(frozen=True)
class Grid:
    """us: (columns,) ascending. vs: (rows,) descending. ws: (rows, columns). points: (rows, columns, 3) mm.

    eye: (3,) of the cutting eye, or (0, 0, 0) if ``vertical``. plane: D, the eye's distance from the plane.
    floor: (4,) lowest and highest x, lowest and highest y of the flat bottom, mm.
    """

    us: FloatArray
    vs: FloatArray
    ws: FloatArray
    points: FloatArray
    eye: FloatArray
    plane: float
    vertical: bool
    floor: FloatArray


def grid_of(solid: Solid, lens: Lens) -> Grid:
    """The grid of a solid's top. Raises InputError if a finisher has turned it into a free mesh."""
    if solid.grid is None:
        raise InputError("the built-in tracer needs the top's regular grid, which a finisher has removed; use mitsuba")
    rows, columns = solid.grid
    points = solid.vertices[: rows * columns].reshape(rows, columns, 3)
    floor = _floor(solid.vertices[rows * columns :])
    if solid.eye_mm is None:
        us, vs, ws = points[0, :, 0].copy(), points[:, 0, 1].copy(), points[..., 2].copy()
        return Grid(us, vs, ws, points, np.zeros(3), 1.0, True, floor)
    eye, plane = solid.eye_mm, float(solid.eye_mm[2] - lens.thickness_mm)
    w = plane / (eye[2] - points[..., 2])
    flat = eye[:2] + (points[..., :2] - eye[:2]) * w[..., None]
    return Grid(flat[0, :, 0].copy(), flat[:, 0, 1].copy(), w, points, eye, plane, False, floor)


def _floor(below: FloatArray) -> FloatArray:
    """The rectangle that the vertices of sides and bottom span; everything if there are none."""
    if not len(below):
        return np.array([-np.inf, np.inf, -np.inf, np.inf])
    return np.stack([below[:, :2].min(axis=0), below[:, :2].max(axis=0)], axis=-1).ravel()
