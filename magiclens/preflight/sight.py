"""What an eye sees of each triangle of an exported top, without the tracer and its grid.

Every triangle is taken for itself, by its middle: where it is in the picture, how much of the picture it fills, at
which angle it is seen, and where on the source its light comes from. Triangles do not hide each other here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Lens, View
from magiclens.optics.refraction import refract, transmittance


@dataclass(frozen=True)
class Sight:
    """Per triangle (F,), from one eye. Lens frame, mm, +y up.

    u, v: place on the reference plane. area: how much of it the triangle fills, mm^2; 0 if it faces away. cosine: of
    the angle between normal and view. x, y: on the source. through: share of light that passes; 0 if it is reflected
    totally at the flat bottom.
    """

    u: FloatArray
    v: FloatArray
    area: FloatArray
    cosine: FloatArray
    x: FloatArray
    y: FloatArray
    through: FloatArray

    @property
    def angle_deg(self) -> FloatArray:
        """(F,) angle between normal and view."""
        return np.degrees(np.arccos(np.clip(self.cosine, -1, 1)))


def look(triangles: FloatArray, lens: Lens, eye_mm: FloatArray) -> Sight:
    """What an eye (3,), lens frame, sees of triangles (F, 3, 3) of the top."""
    out = _look(triangles, np.asarray(eye_mm, float), lens.thickness_mm, lens.gap_mm, lens.ior)
    return Sight(*out)


def looks(triangles: FloatArray, lens: Lens, views: Sequence[View]) -> list[Sight]:
    """One per view, in the lens frame; views from one eye share it."""
    made: dict[bytes, Sight] = {}
    for view in views:
        if view.eye_mm.tobytes() not in made:
            made[view.eye_mm.tobytes()] = look(triangles, lens, view.eye_mm)
    return [made[view.eye_mm.tobytes()] for view in views]


def slopes_deg(triangles: FloatArray) -> FloatArray:
    """(F,) angle between +z and the outward normal; above 90 it faces down."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross((b - a).astype(np.float64), (c - a).astype(np.float64))
    return np.asarray(np.degrees(np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), normal[:, 2])))


def facets_of(triangles: FloatArray, lens: Lens, eye_mm: FloatArray | None) -> tuple[IntArray, BoolArray]:
    """Per triangle (F,): the facet that it lies in, row * N + column, and whether it is of a wall, the rim or beyond.

    eye_mm: (3,) along whose rays the facets are cut; None for vertical cells.
    """
    middle = triangles.mean(axis=1, dtype=np.float64)
    if eye_mm is not None:
        away = (eye_mm[2] - lens.thickness_mm) / (eye_mm[2] - middle[:, 2])
        middle = eye_mm + (middle - eye_mm) * away[:, None]
    places = np.stack([lens.size_mm / 2 - middle[:, 1], middle[:, 0] + lens.size_mm / 2]) / lens.pitch_mm
    index = np.clip(places.astype(int), 0, lens.facets - 1)
    border = 0.51 * lens.wall_mm / lens.pitch_mm
    off = (np.minimum(places - index, index + 1 - places) < border).any(axis=0)
    return index[0] * lens.facets + index[1], off


@njit(cache=True, parallel=True)
def _look(triangles, eye, thickness, gap, ior):
    count = len(triangles)
    out = np.zeros((7, count))
    for f in prange(count):
        ax, ay, az = float(triangles[f, 0, 0]), float(triangles[f, 0, 1]), float(triangles[f, 0, 2])
        bx, by, bz = float(triangles[f, 1, 0]), float(triangles[f, 1, 1]), float(triangles[f, 1, 2])
        cx, cy, cz = float(triangles[f, 2, 0]), float(triangles[f, 2, 1]), float(triangles[f, 2, 2])
        px, py, pz = bx - ax, by - ay, bz - az
        qx, qy, qz = cx - ax, cy - ay, cz - az
        nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        double = sqrt(nx * nx + ny * ny + nz * nz)
        if double == 0.0:
            continue
        nx, ny, nz = nx / double, ny / double, nz / double
        gx, gy, gz = (ax + bx + cx) / 3, (ay + by + cy) / 3, (az + bz + cz) / 3
        dx, dy, dz = gx - eye[0], gy - eye[1], gz - eye[2]
        far = sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / far, dy / far, dz / far
        cosine = -(dx * nx + dy * ny + dz * nz)
        stretch = (eye[2] - thickness) / (eye[2] - gz)
        out[0, f] = eye[0] + (gx - eye[0]) * stretch
        out[1, f] = eye[1] + (gy - eye[1]) * stretch
        out[3, f] = cosine
        if cosine <= 0.0 or dz >= 0.0:
            continue
        out[2, f] = 0.5 * double * cosine * stretch * stretch / -dz
        tx, ty, tz = refract(dx, dy, dz, nx, ny, nz, ior)
        if tz >= 0.0:
            continue
        weight = transmittance(cosine, ior) * transmittance(-tz, 1.0 / ior)
        if weight <= 0.0:
            continue
        ox, oy, oz = refract(tx, ty, tz, 0.0, 0.0, 1.0, 1.0 / ior)
        if oz >= 0.0:
            continue
        out[4, f] = gx - tx * gz / tz - ox * gap / oz
        out[5, f] = gy - ty * gz / tz - oy * gap / oz
        out[6, f] = weight
    return out
