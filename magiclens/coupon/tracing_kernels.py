"""Kernels of the forward model: from the camera's pixels through the coupon to the sheet."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.kernels.compiler import njit
from magiclens.kernels.sampling import blend, clamped_cell
from magiclens.kernels.threads import LoopPart
from magiclens.optics.refraction import refract, transmittance


class PinholeCamera(NamedTuple):
    """A camera: focal length in pixels, the middle of its picture, radial distortion, where it is and how it looks.

    Args:
        focal: pixels.
        middle_x, middle_y: the principal point, pixels from the top left corner.
        distortion: a point at r focal lengths from the middle is seen along a ray at r (1 + distortion r^2).
        place: (3,) mm, in the frame of the sheet.
        axes: (3, 3) rows: the camera's right, down and forward, in the frame of the sheet.
    """

    focal: float
    middle_x: float
    middle_y: float
    distortion: float
    place: np.ndarray
    axes: np.ndarray


class LyingSurface(NamedTuple):
    """A raster of heights and slopes, row 0 at +y, and where its body lies on the sheet.

    Args:
        z, zx, zy: (rows, columns) float32: height, mm, and its derivatives.
        left, top: x and y of the first point, mm, in the frame of the coupon.
        across, down: distance of columns and of rows, mm.
        shift_x, shift_y, turn: where the coupon's middle is on the sheet, mm, and its turn, radians.
        gap: air below it, mm.
        ior: its index of refraction.
    """

    z: np.ndarray
    zx: np.ndarray
    zy: np.ndarray
    left: float
    top: float
    across: float
    down: float
    shift_x: float
    shift_y: float
    turn: float
    gap: float
    ior: float


class LightSheet(NamedTuple):
    """The sheet's picture, (H, W) float32, row 0 at +y, its middle at (0, 0), and its pixels per mm."""

    picture: np.ndarray
    per_mm: float


class PixelGrid(NamedTuple):
    """Where the first pixel begins in the photograph, the side of a pixel, and the number of rays along that side.

    Sides are in pixels of the photograph.
    """

    left: float
    top: float
    side: float
    rays: int


@njit(cache=True)
def _at(raster, column, row):
    """A raster between its points, bilinearly; beyond its border it goes on."""
    j, i, a, b = clamped_cell(column, row, raster.shape[1], raster.shape[0])
    return blend((raster[i, j], raster[i, j + 1]), (raster[i + 1, j], raster[i + 1, j + 1]), a, b)


@njit(cache=True)
def _through(px, py, pz, dx, dy, dz, body):
    """Where a ray ends on the sheet, in the frame of the coupon, how much light passes, and where it meets the top.

    The light is 1 beside the coupon, where the third and fourth numbers mean nothing.
    """
    rows, columns = body.z.shape
    height = 3.5 + body.gap
    c, r = 0.0, 0.0
    for _ in range(5):
        t = (height - pz) / dz
        c = (px + t * dx - body.left) / body.across
        r = (body.top - py - t * dy) / body.down
        if c < 0 or r < 0 or c >= columns - 1 or r >= rows - 1:
            t = -pz / dz
            return px + t * dx, py + t * dy, 1.0, 1e9, 1e9
        height = _at(body.z, c, r) + body.gap
    t = (height - pz) / dz
    x, y = px + t * dx, py + t * dy
    sx, sy = _at(body.zx, c, r), _at(body.zy, c, r)
    q = 1.0 / math.sqrt(1.0 + sx * sx + sy * sy)
    light = transmittance((dx * sx + dy * sy - dz) * q, body.ior) if dx * sx + dy * sy < dz * -1.0 else 0.0
    ex, ey, ez = refract(dx, dy, dz, -sx * q, -sy * q, q, body.ior)
    if ez >= 0.0 or light <= 0.0:
        return x, y, 0.0, x, y
    t = (body.gap - height) / ez
    bx, by = x + t * ex, y + t * ey
    fx, fy, fz = refract(ex, ey, ez, 0.0, 0.0, 1.0, 1.0 / body.ior)
    if fz >= 0.0:
        return bx, by, 0.0, x, y
    t = -body.gap / fz
    return bx + t * fx, by + t * fy, light * transmittance(-ez, 1.0 / body.ior), x, y


@njit(cache=True)
def _ink(sheet, x, y):
    """The sheet's light at a point, bilinearly; beyond its border it goes on."""
    height, width = sheet.picture.shape
    return _at(sheet.picture, x * sheet.per_mm + width / 2 - 0.5, height / 2 - y * sheet.per_mm - 0.5)


@njit(cache=True, nogil=True)
def expose_rows(part: LoopPart, camera, body, sheet, pixels, out):
    """Follow the rays of pixels to the sheet.

    Args:
        part: the rows.
        camera: a ``PinholeCamera``.
        body: a ``LyingSurface``.
        sheet: a ``LightSheet``.
        pixels: a ``PixelGrid``.
        out: (rows, columns, 5) float64, to fill with means over a pixel's rays: its light; x, y on the sheet, mm; x, y
            on the top in the coupon's frame, mm, which are large beside the coupon.
    """
    cos, sin = math.cos(body.turn), math.sin(body.turn)
    ox, oy = camera.place[0] - body.shift_x, camera.place[1] - body.shift_y
    px, py, pz = cos * ox + sin * oy, cos * oy - sin * ox, camera.place[2]
    axes, rays = camera.axes, pixels.rays
    for i in range(part.first, part.end):
        for j in range(out.shape[1]):
            out[i, j] = 0.0
            for k in range(rays * rays):
                u = pixels.left + (j + (k % rays + 0.5) / rays) * pixels.side
                v = pixels.top + (i + (k // rays + 0.5) / rays) * pixels.side
                u, v = (u - camera.middle_x) / camera.focal, (v - camera.middle_y) / camera.focal
                far = 1.0 + camera.distortion * (u * u + v * v)
                u, v = u * far, v * far
                wx = u * axes[0, 0] + v * axes[1, 0] + axes[2, 0]
                wy = u * axes[0, 1] + v * axes[1, 1] + axes[2, 1]
                wz = u * axes[0, 2] + v * axes[1, 2] + axes[2, 2]
                q = 1.0 / math.sqrt(wx * wx + wy * wy + wz * wz)
                dx, dy, dz = (cos * wx + sin * wy) * q, (cos * wy - sin * wx) * q, wz * q
                x, y, light, tx, ty = _through(px, py, pz, dx, dy, dz, body)
                x, y = cos * x - sin * y + body.shift_x, sin * x + cos * y + body.shift_y
                out[i, j, 0] += light * _ink(sheet, x, y) / (rays * rays)
                out[i, j, 1] += x / (rays * rays)
                out[i, j, 2] += y / (rays * rays)
                out[i, j, 3] += tx / (rays * rays)
                out[i, j, 4] += ty / (rays * rays)
