"""Weights of error diffusion that put the noise of rounding where a process evens it out."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.processes.linear import LinearProcess

FLOYD_STEINBERG = np.array([[0, 0, 7], [3, 5, 1]]) / 16
"""(2, 3): R. W. Floyd and L. Steinberg, "An adaptive algorithm for spatial greyscale", Proc. SID 17, 1976."""
_REACH = 3
"""Pixels ahead, below and aside that the error of a pixel is passed on to."""
_WAVES = 256
"""Samples of the spectrum along each axis."""
_FLOORS = (1e-3, 1e-2, 1e-1)
"""How much noise counts that the process takes out, relative to the mean of what it leaves: the more, the nearer
columns stay to their heights."""
_MOST_NOISE = 4.0
"""Largest variance of the heights' noise, relative to plain rounding's. At 4 columns are half a layer off, rms."""
_LEVEL_MM = 1.0
"""Heights count beside slopes as if they were waves of 2 pi times this length: the mean height has to be right."""


@lru_cache(maxsize=8)
def diffusion_weights(process: LinearProcess, pixel_mm: tuple[float, float]) -> FloatArray:
    """How the error of a column is shared out, so that the least of it is left in the slopes of the made surface.

    With e the error of every column, which is noise of no direction, the heights are off by ``e - sum(w e)`` over the
    columns before. Nothing but the process's own transfer function decides which weights leave the least of that: they
    are those that predict a signal whose spectrum is what the process leaves of slopes, from its neighbours that come
    before (linear prediction, N. Wiener 1949). What is left lies in waves that the process takes out.

    Args:
        process: What evens the surface out. Where it is none, nothing is taken out, and the weights are Floyd's and
            Steinberg's.
        pixel_mm: Width and height of a column.

    Returns:
        (rows, 2 reach + 1): row 0 is that of the column itself, of which only what comes after it is not 0; the middle
        is below the column.
    """
    if process.finest_mm == 0:
        return FLOYD_STEINBERG
    left = _left_of_slopes(process, pixel_mm)
    lags = np.array([(i, j) for i in range(_REACH + 1) for j in range(-_REACH, _REACH + 1) if i > 0 or j > 0])
    for floor in _FLOORS:
        shares = _predictors(left + floor, lags)
        if 1 + float(shares @ shares) <= _MOST_NOISE:
            break
    weights = np.zeros((_REACH + 1, 2 * _REACH + 1))
    weights[lags[:, 0], lags[:, 1] + _REACH] = shares
    return weights


def _left_of_slopes(process: LinearProcess, pixel_mm: tuple[float, float]) -> FloatArray:
    """(W, W) the power that slopes, and a little of it heights, of white noise keep, in the order of an FFT; mean 1."""
    across, down = (2 * math.pi * np.fft.fftfreq(_WAVES, pitch) for pitch in pixel_mm)
    waves = np.hypot(across[None, :], down[:, None])
    power = (waves**2 + _LEVEL_MM**-2) * process.kept(waves) ** 2
    return np.asarray(power / power.mean())


def _predictors(power: FloatArray, lags: IntArray) -> FloatArray:
    """(L,) weights of the neighbours at lags (L, 2) that predict a signal of this power spectrum best."""
    alike = np.fft.ifft2(power).real
    between = lags[:, None] - lags[None]
    return np.linalg.solve(alike[between[..., 0], between[..., 1]], alike[lags[:, 0], lags[:, 1]])
