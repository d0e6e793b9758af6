"""What a photograph of a coupon shows, for given parameters of process, material and camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.units import LENGTH
from magiclens.coupon.photograph import CouponPhotograph
from magiclens.coupon.sheet import SHEET_PX_PER_MM, sheet_picture
from magiclens.processes.linear import LinearProcess, filtered, raster_wavenumbers

_STENCIL = np.array([1, -8, 0, 8, -1]) / 12
"""The derivative to fourth order: finest waves have few pixels."""


class Unknowns(NamedTuple):
    """Everything that a photograph depends on.

    ``variance`` is the square of the process's spread, mm^2, and ``fourth`` the fourth power of its levelling
    wavelength, mm^4: what is seen depends on these smoothly, down to 0. ``log_focal`` is the logarithm of the focal
    length in pixels; ``lean_x``, ``lean_y`` and ``lean_z`` are the camera's turn, a rotation vector in radians;
    ``camera_*`` its place, mm; ``blur_px`` its own blur. ``shift_*``, ``turn`` and ``gap`` say how the coupon lies.
    """

    variance: float
    fourth: float
    ior: float
    gap: float
    shift_x: float
    shift_y: float
    turn: float
    lean_x: float
    lean_y: float
    lean_z: float
    camera_x: float
    camera_y: float
    camera_z: float
    log_focal: float
    distortion: float
    blur_px: float


@dataclass(frozen=True)
class LayeredTop:
    """Heights before the process, on the printer's pixels.

    Attributes:
        heights: (rows, columns) mm, whole layers, row 0 at +y.
        x_mm: (columns,) ascending.
        y_mm: (rows,) descending.
    """

    heights: FloatArray
    x_mm: FloatArray
    y_mm: FloatArray


class CouponModel:
    """Predicts a photograph; surfaces that were asked for last are kept."""

    def __init__(self, raster: LayeredTop, photograph: CouponPhotograph, step: int = 1, rays: int = 1):
        """Begin without any surface.

        Args:
            raster: What the process is applied to.
            photograph: Its size and place count, not its light.
            step: Number of the photograph's pixels along the side of a predicted one.
            rays: Number of rays along the side of a predicted pixel.
        """
        self._raster, self._photograph, self._step, self._rays = raster, photograph, step, rays
        self._pitch = float(raster.x_mm[1] - raster.x_mm[0]), float(raster.y_mm[0] - raster.y_mm[1])
        self._wavenumbers = raster_wavenumbers(raster.heights.shape, self._pitch).astype(np.float32)
        self._surface = lru_cache(maxsize=3)(self._made)
        rows, columns = photograph.light.shape
        self.shape = rows // step, columns // step
        self._sheet = sheet_picture()

    def seen(self, at: Unknowns) -> FloatArray:
        """What each pixel sees, before the camera blurs it: (rows, columns, 5), see ``expose_rows``."""
        from magiclens.coupon.tracing_kernels import LightSheet, LyingSurface, PixelGrid, expose_rows
        from magiclens.kernels.threads import in_threads

        place = float(self._raster.x_mm[0]), float(self._raster.y_mm[0]), *self._pitch
        lying = at.shift_x, at.shift_y, at.turn, at.gap, at.ior
        body = LyingSurface(*self._surface(at.variance, at.fourth), *place, *lying)
        left, top = self._photograph.first
        pixels = PixelGrid(float(left), float(top), float(self._step), self._rays)
        out = np.empty((*self.shape, 5))
        in_threads(expose_rows, len(out), self._camera(at), body, LightSheet(self._sheet, SHEET_PX_PER_MM), pixels, out)
        return out

    def light(self, at: Unknowns) -> FloatArray:
        """What the camera sees where white paper sends the light 1 and ink none: (rows, columns)."""
        from scipy.ndimage import gaussian_filter

        blurred: FloatArray = gaussian_filter(self.seen(at)[..., 0], abs(at.blur_px) / self._step, mode="nearest")
        return blurred

    def _camera(self, at: Unknowns) -> tuple[float | FloatArray, ...]:
        from magiclens.coupon.tracing_kernels import PinholeCamera

        width, height = self._photograph.size
        place = np.array([at.camera_x, at.camera_y, at.camera_z])
        axes = camera_axes((at.lean_x, at.lean_y, at.lean_z))
        return PinholeCamera(math.exp(at.log_focal), width / 2, height / 2, at.distortion, place, axes)

    def _made(self, variance: float, fourth: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Heights and slopes as the process leaves them, (rows, columns) float32 each."""
        from scipy.ndimage import correlate1d

        spread, levelling = math.sqrt(max(variance, 0.0)), max(fourth, 0.0) ** 0.25
        process = LinearProcess(spread=LENGTH.text(spread), levelling=LENGTH.text(levelling))
        z = filtered(self._raster.heights.astype(np.float32), process.kept(self._wavenumbers).astype(np.float32))
        zx = correlate1d(z, _STENCIL.astype(np.float32) / self._pitch[0], axis=1, mode="nearest")
        zy = correlate1d(z, -_STENCIL.astype(np.float32) / self._pitch[1], axis=0, mode="nearest")
        return z, zx, zy


def camera_axes(lean: tuple[float, float, float]) -> FloatArray:
    """(3, 3) right, down and forward of a camera that is turned by a rotation vector from looking straight down."""
    from scipy.spatial.transform import Rotation

    axes: FloatArray = Rotation.from_rotvec(lean).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    return axes
