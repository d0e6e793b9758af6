"""What making leaves of a surface's waves: the linear part of a process, as a transfer function."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.units import Length


class LinearProcess(BaseModel):
    """How a process evens a surface out: material that spreads sideways, and a liquid film that levels.

    A wave of the wavelength ``lambda`` keeps ``exp(-(2 pi spread / lambda)^2 / 2)`` of its height where material
    spreads like a Gaussian, and ``exp(-(levelling / lambda)^4)`` of it under a film (S. E. Orchard, "On surface
    levelling in viscous liquids and gels", Appl. Sci. Res. 11, 1962). The mean height is kept.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    spread: Length = Field("0mm", validate_default=True, ge=0, le=10, description="sigma of a Gaussian")
    levelling: Length = Field(
        "0mm", validate_default=True, ge=0, le=50, description="wavelength of which a liquid film leaves 1/e"
    )

    def kept(self, wavenumbers: FloatArray) -> FloatArray:
        """The share of a wave's height that is kept.

        Args:
            wavenumbers: 2 pi / wavelength, per mm, of any shape.

        Returns:
            0 to 1, of the same shape.
        """
        gaussian = 0.5 * (self.spread * wavenumbers) ** 2
        # beyond the exponent nothing is left; its fourth power would overflow
        film = np.minimum(self.levelling / (2 * math.pi) * wavenumbers, 10.0) ** 4
        return np.asarray(np.exp(-gaussian - film))

    @property
    def finest_mm(self) -> float:
        """Pitch of a raster that holds all of a made surface: of a wave of two steps, a thousandth is left."""
        # with x = 1 / wavelength^2 the exponent is a x + b x^2
        a, b, gone = 2 * (math.pi * self.spread) ** 2, self.levelling**4, math.log(1000)
        if a == 0 and b == 0:
            return 0.0
        x = gone / a if b == 0 else (math.sqrt(a * a + 4 * gone * b) - a) / (2 * b)
        return 0.5 / math.sqrt(x)

    @property
    def strip_mm(self) -> float:
        """Width of the strip along a border of two facets in which one slope turns into the other.

        It is 4 sigma of a Gaussian; of a film, which is none, of the Gaussian that leaves as much of ``levelling``.
        """
        return 4 * math.hypot(self.spread, self.levelling / (math.sqrt(2) * math.pi))

    @property
    def reach_mm(self) -> float:
        """How far from an edge of the body the surface is no longer as designed."""
        return 6.0 * self.spread + 1.5 * self.levelling

    def of(self, heights: FloatArray, pitch_mm: tuple[float, float]) -> FloatArray:
        """The surface that is left of heights on a raster.

        Args:
            heights: (rows, columns), mm.
            pitch_mm: distance between columns (x) and between rows (y).

        Returns:
            (rows, columns) float64, mm. Beyond the raster's border the surface goes on level, or mirrored.
        """
        from scipy.ndimage import gaussian_filter

        z = np.asarray(heights, np.float64)
        if self.levelling == 0:  # a Gaussian alone is quicker beside it
            even: FloatArray = gaussian_filter(
                z, (self.spread / pitch_mm[1], self.spread / pitch_mm[0]), mode="nearest"
            )
            return even
        return filtered(z, self.kept(raster_wavenumbers(z.shape, pitch_mm)))


def raster_wavenumbers(shape: tuple[int, ...], pitch_mm: tuple[float, float]) -> FloatArray:
    """Wavenumbers of the cosine transform (DCT-II) of a raster: 2 pi / wavelength, per mm.

    Args:
        shape: (rows, columns).
        pitch_mm: distance between columns (x) and between rows (y).

    Returns:
        (rows, columns) float64.
    """
    down, right = (math.pi * np.arange(n) / (n * p) for n, p in zip(shape, pitch_mm[::-1], strict=True))
    return np.asarray(np.hypot(down[:, None], right[None, :]))


def filtered(raster: FloatArray, factors: FloatArray) -> FloatArray:
    """A raster whose waves are multiplied by factors; it is mirrored at its borders.

    Args:
        raster: (rows, columns) floats.
        factors: (rows, columns) floats, one for each of ``raster_wavenumbers``.

    Returns:
        (rows, columns) of the raster's precision.
    """
    from scipy.fft import dctn, idctn

    spectrum = dctn(raster, norm="ortho", workers=-1)
    spectrum *= factors
    found: FloatArray = idctn(spectrum, norm="ortho", workers=-1, overwrite_x=True)
    return found
