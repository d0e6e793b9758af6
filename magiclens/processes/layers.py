"""Heights in layers: how a slicer rounds, how error diffusion does, and what grey pixels add to whole layers."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.processes.diffusion import FLOYD_STEINBERG
from magiclens.processes.linear import LinearProcess

Slicing = Literal["plain", "diffused"]
"""``plain`` rounds every column of pixels by itself, as slicers do; ``diffused`` passes errors on to its neighbours."""
_WAVES = 40
"""Waves of a saw tooth that count."""
WHOLE_LAYERS = np.zeros(1)
"""The shares of layers that a machine without grey makes: none but whole ones, see ``Grey.shares``."""


class Grey(BaseModel):
    """Pixels that are exposed in steps: the top of a column is then a part of a layer.

    Material grows only from some exposure on, and then with its logarithm (Jacobs' equation: the cured depth is ``Dp
    ln(E / Ec)``). ``growth`` says how high, as measured or estimated.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    bits: int = Field(8, ge=1, le=8, description="2^bits steps of exposure, black and white included")
    growth: tuple[tuple[float, float], ...] = Field(
        ((0.45, 0.0), (0.55, 0.25), (0.65, 0.46), (0.75, 0.64), (0.85, 0.8), (1.0, 1.0)),
        description="pairs: share of full exposure, share of the layer's height that cures; straight lines in between",
    )

    @field_validator("growth")
    @classmethod
    def _grows(cls, pairs: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        rising = all(a[0] < b[0] and a[1] <= b[1] for a, b in pairwise(pairs))
        if len(pairs) < 2 or not rising or min(pairs[0]) < 0 or pairs[0][1] != 0 or pairs[-1] != (1.0, 1.0):
            raise ValueError("must rise from no height to [1, 1], such as [[0.45, 0], [0.7, 0.55], [1, 1]]")
        return pairs

    def steps(self) -> tuple[IntArray, FloatArray]:
        """What a pixel above the last whole layer can be.

        Returns:
            (L,) values 0 to 254 of 8-bit pixels; (L,) ascending shares of the layer's height, from 0, below 1.
        """
        exposures = np.arange(2**self.bits) / (2**self.bits - 1)
        shares = np.interp(exposures, *np.array(self.growth).T)
        # of the exposures from which nothing grows, the first: no light; white is a whole layer
        shares, first = np.unique(shares, return_index=True)
        below = shares < 1
        return np.rint(255 * exposures[first[below]]).astype(np.int64), shares[below]

    @property
    def shares(self) -> FloatArray:
        """(L,) see ``steps``."""
        return self.steps()[1]

    def share_of_pixels(self) -> FloatArray:
        """(256,) what the steps' 8-bit values fill of a voxel; 0 for values that are none."""
        values, shares = self.steps()
        filled = np.zeros(256)
        filled[values], filled[255] = shares, 1.0
        return filled


def tops_of(
    heights: FloatArray,
    layer_mm: float,
    slicing: Slicing,
    shares: FloatArray = WHOLE_LAYERS,
    weights: FloatArray = FLOYD_STEINBERG,
) -> IntArray:
    """The top of each column of pixels as a number: ``whole layers * L + step``, for ``shares[step]`` of a layer more.

    Plain rounding turns a gentle slope into stairs, which are wide, so that no finish evens them out. Error diffusion
    gives columns one or the other of neighbouring tops in turns: the mean is right everywhere, and what is wrong is as
    fine as the pixels.

    Args:
        heights: (rows, columns) of the columns, mm.
        layer_mm: height of a layer.
        slicing: how heights are rounded.
        shares: (L,) of a layer's height, see ``Grey``.
        weights: Of error diffusion, see ``diffusion_weights``.

    Returns:
        (rows, columns) int32.
    """
    between = (shares + np.append(shares[1:], 1.0)) / 2  # from there on, the next step is nearer
    if slicing == "plain":
        z = np.asarray(heights, np.float64) / layer_mm
        whole = np.floor(z)
        steps = np.searchsorted(between, z - whole, side="right")
        return np.asarray(whole * len(shares) + steps, np.int32)
    from magiclens.processes.layers_kernels import Rounding, diffuse_errors

    tops = np.zeros(heights.shape, np.int32)
    rounding = Rounding(float(layer_mm), shares, between, weights.astype(np.float32))
    diffuse_errors(np.asarray(heights, np.float32), rounding, tops)
    return tops


def layers_of_tops(tops: IntArray, shares: FloatArray = WHOLE_LAYERS) -> FloatArray:
    """Heights of tops, in layers, float64; arguments as of ``tops_of``."""
    whole, step = np.divmod(tops, len(shares))
    return np.asarray(whole + shares[step])


def stair_slopes(
    process: LinearProcess, layer_mm: float, pixel_mm: tuple[float, float], gradients: FloatArray
) -> FloatArray:
    """How far slopes are off, rms, because layers are rounded plainly.

    A slope becomes stairs: what is missing or too much is a saw tooth, whose n-th wave is n times as short as a step
    and 1 / (pi n) of a layer high. It is sampled by the columns of pixels; of a wave that is shorter than two of them
    the columns show a longer one (aliasing). The process leaves its share of that.

    Args:
        process: What evens the surface out.
        layer_mm: Height of a layer.
        pixel_mm: Width and depth of a column of pixels.
        gradients: (..., 2) rise of the surface along x and along y, against the layers.

    Returns:
        (...) float64.
    """
    pixel = np.array(pixel_mm)
    cycles = gradients * pixel / layer_mm
    squares = np.zeros(gradients.shape[:-1])
    for n in range(1, _WAVES + 1):
        seen = n * cycles - np.rint(n * cycles)  # per pixel, of the wave that the columns show
        waves = np.hypot(*np.moveaxis(2 * np.pi * seen / pixel, -1, 0))
        squares += (layer_mm / (np.pi * n) * waves * process.kept(waves)) ** 2 / 2
    return np.sqrt(squares)
