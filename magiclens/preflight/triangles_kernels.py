"""Kernels that trace the triangles of an exported top, one ray for each."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.optics.refraction import refract, transmittance


class TracedTriangles(NamedTuple):
    """What one eye sees of triangles, by the ray through the middle of each; lens frame.

    Args:
        u: (F,) x of the point of the reference plane at which the triangle's middle is seen, mm.
        v: (F,) its y.
        area: (F,) how much of the reference plane the triangle fills, mm^2; 0 if it faces away from the eye.
        cosine: (F,) cosine of the angle between the outward normal and the way back to the eye.
        x: (F,) x of the point at which the ray meets the source, mm.
        y: (F,) its y.
        through: (F,) share of the light that passes both surfaces; 0 if the flat bottom reflects it totally.
    """

    u: FloatArray
    v: FloatArray
    area: FloatArray
    cosine: FloatArray
    x: FloatArray
    y: FloatArray
    through: FloatArray


@njit(cache=True, nogil=True)
def _trace(triangles, eye, thickness, gap, ior, traced):
    """See ``trace_middles``; traced: zeros, to fill."""
    u, v, area, cosines, x, y, through = traced
    for f in range(len(triangles)):
        # float() makes them float64: small triangles are small differences of float32 numbers
        ax, ay, az = float(triangles[f, 0, 0]), float(triangles[f, 0, 1]), float(triangles[f, 0, 2])
        bx, by, bz = float(triangles[f, 1, 0]), float(triangles[f, 1, 1]), float(triangles[f, 1, 2])
        cx, cy, cz = float(triangles[f, 2, 0]), float(triangles[f, 2, 1]), float(triangles[f, 2, 2])
        px, py, pz = bx - ax, by - ay, bz - az
        qx, qy, qz = cx - ax, cy - ay, cz - az
        nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        double = sqrt(nx * nx + ny * ny + nz * nz)  # twice the area
        if double == 0.0:
            continue
        nx, ny, nz = nx / double, ny / double, nz / double
        gx, gy, gz = (ax + bx + cx) / 3, (ay + by + cy) / 3, (az + bz + cz) / 3
        dx, dy, dz = gx - eye[0], gy - eye[1], gz - eye[2]
        far = sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / far, dy / far, dz / far
        cosine = -(dx * nx + dy * ny + dz * nz)
        stretch = (eye[2] - thickness) / (eye[2] - gz)
        u[f] = eye[0] + (gx - eye[0]) * stretch
        v[f] = eye[1] + (gy - eye[1]) * stretch
        cosines[f] = cosine
        if cosine <= 0.0 or dz >= 0.0:
            continue
        area[f] = 0.5 * double * cosine * stretch * stretch / -dz
        tx, ty, tz = refract(dx, dy, dz, nx, ny, nz, ior)
        if tz >= 0.0:
            continue
        # the flat bottom's normal is +z, so -tz is the cosine of the angle there
        weight = transmittance(cosine, ior) * transmittance(-tz, 1.0 / ior)
        if weight <= 0.0:
            continue
        ox, oy, oz = refract(tx, ty, tz, 0.0, 0.0, 1.0, 1.0 / ior)
        if oz >= 0.0:
            continue
        x[f] = gx - tx * gz / tz - ox * gap / oz
        y[f] = gy - ty * gz / tz - oy * gap / oz
        through[f] = weight


def trace_middles(triangles: FloatArray, eye: FloatArray, thickness: float, gap: float, ior: float) -> TracedTriangles:
    """Trace a ray from the eye through the middle g of each triangle, by Snell's and Fresnel's laws, to the source.

    With n the unit normal, d the unit direction of the ray and s = (eye_z - thickness) / (eye_z - g_z), the middle is
    seen at ``eye + s (g - eye)`` on the reference plane, and the triangle of area A fills ``A (-d . n) s^2 / -d_z``
    of it. The ray is refracted at the triangle (direction t) and at the flat bottom z = 0 (direction o), and meets the
    source, at z = -gap, at ``g - t g_z / t_z - o gap / o_z``.

    Args:
        triangles: (F, 3, 3) corners, mm.
        eye: (3,) mm.
        thickness: Height of the reference plane, mm.
        gap: Distance between flat bottom and source, mm.
        ior: Index of refraction.

    Returns:
        TracedTriangles.
    """
    traced = TracedTriangles(*np.zeros((7, len(triangles))))
    _trace(triangles, eye, thickness, gap, ior, traced)
    return traced


@njit(cache=True, nogil=True)
def throw_light(traced, source, sizes, side, light):
    """Add every triangle's light to the pixel of a picture in which its middle is seen, see ``light_in_pixels``.

    Args:
        traced: What the eye sees of the triangles.
        source: (H, W, C) linear light.
        sizes: Sides of the source and of the picture, mm.
        side: S, pixels along the picture's side.
        light: (S * S, C + 1), which is added to: sums of linear light times area, and of areas, mm^2.
    """
    u, v, areas, _, x, y, through = traced
    rows, columns, channels = source.shape
    scale, half_source, half = columns / sizes[0], sizes[0] / 2, sizes[1] / 2
    for f in range(len(u)):
        area = areas[f]
        if area == 0.0 or max(abs(u[f]), abs(v[f])) > half:
            continue
        # rows go down and v goes up, hence its minus
        pixel = _pixel(-v[f] * side / sizes[1], side) * side + _pixel(u[f] * side / sizes[1], side)
        light[pixel, channels] += area
        if through[f] == 0.0 or max(abs(x[f]), abs(y[f])) > half_source:
            continue
        row, column = _pixel(-y[f] * scale, rows), _pixel(x[f] * scale, columns)
        for k in range(channels):
            light[pixel, k] += source[row, column, k] * area * through[f]


@njit(cache=True, forceinline=True)
def _pixel(position, count):
    """The pixel, of ``count`` along an axis, that a position from the middle lies in."""
    return min(max(int(position + 0.5 * count), 0), count - 1)
