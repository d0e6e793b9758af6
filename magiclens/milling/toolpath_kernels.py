"""Kernels that turn heights sampled along a line into few straight moves that never pass below them."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads

_UNEVEN = 3.0
"""Samples count as a jump where they bend down by this many times more than the cutter's own roundness explains."""
_NOISE_MM = 2e-4
"""Bends below this come from rounding."""


@njit(cache=True, nogil=True)
def _covering_part(part, z, bend, out):
    """Part of the rows, see ``covering``."""
    for row in range(part.first, part.end):
        for i in range(1, z.shape[1] - 1):
            if z[row, i - 1] - 2.0 * z[row, i] + z[row, i + 1] < -_UNEVEN * bend - _NOISE_MM:
                out[row, i - 1] = max(out[row, i - 1], z[row, i])
                out[row, i + 1] = max(out[row, i + 1], z[row, i])


def covering(z: FloatArray, bend: float) -> FloatArray:
    """Raise heights beside jumps, so that straight lines between samples stay above the cutter's true path too.

    Between two samples the path bulges by no more than the cutter's roundness allows, unless it jumps. Where it
    jumps (second differences below ``-_UNEVEN * bend``), the lower side is raised to the upper one.

    Args:
        z: (rows, columns) float64, tip heights sampled along each row, mm.
        bend: second difference of the samples that the cutter's roundness explains, mm: spacing^2 / radius.
    """
    out = z.copy()
    in_threads(_covering_part, len(z), z, bend, out)
    return out


@njit(cache=True, nogil=True)
def _thinned_part(part, z, every, out):
    """Part of the rows, see ``thinned``."""
    columns = out.shape[1]
    for row in range(part.first, part.end):
        for k in range(columns):
            out[row, k] = z[row, k * every]
        missing = np.zeros(columns)
        for k in range(columns - 1):
            a, b = z[row, k * every], z[row, (k + 1) * every]
            for i in range(1, every):
                lack = z[row, k * every + i] - (a + (b - a) * i / every)
                missing[k], missing[k + 1] = max(missing[k], lack), max(missing[k + 1], lack)
        out[row] += missing


def thinned(z: FloatArray, every: int) -> FloatArray:
    """One in ``every`` samples, raised until straight lines between them are nowhere below the other samples.

    Args:
        z: (rows, columns) heights, mm; columns - 1 is a multiple of ``every``.
        every: number of samples from one that is kept to the next.

    Returns:
        (rows, 1 + (columns - 1) / every) heights, mm.
    """
    out = np.empty((len(z), (z.shape[1] - 1) // every + 1))
    in_threads(_thinned_part, len(z), z, every, out)
    return out


@njit(cache=True)
def segments(z, dx, tolerance, step):
    """Fit few segments over samples: z[k] <= line(k) <= z[k] + tolerance at every sample k.

    Greedy: from each corner the range of slopes that keep the bounds narrows sample by sample; the last sample at which
    a height on the machine's grid lies in that range becomes the next corner.

    Args:
        z: (samples,) float64, heights, mm.
        dx: distance of samples, mm.
        tolerance: most that the line may be above a sample, mm.
        step: the machine's step, mm.

    Returns:
        (corners,) int64, samples at which the line turns, and (corners,) int64, its heights there in steps.
    """
    corner, count = np.empty(len(z), np.int64), np.empty(len(z), np.int64)
    corner[0], count[0], n = 0, _up(z[0], step), 1
    while corner[n - 1] < len(z) - 1:
        start, base = corner[n - 1], count[n - 1] * step
        # the next sample can always be a corner: its height is rounded up to the grid, whatever the tolerance
        corner[n], count[n] = start + 1, _up(z[start + 1], step)
        low, high = -math.inf, math.inf
        for k in range(start + 1, len(z)):
            way = (k - start) * dx
            low, high = max(low, (z[k] - base) / way), min(high, (z[k] + tolerance - base) / way)
            if low > high:
                break
            up = _up(base + low * way, step)
            if up * step <= base + high * way + 1e-12:  # 1e-12: rounding must not refuse a height exactly at the bound
                corner[n], count[n] = k, up
        n += 1
    return corner[:n].copy(), count[:n].copy()


@njit(cache=True)
def _up(z, step):
    """The least multiple of ``step`` that is not below z, but for rounding errors."""
    return math.ceil(z / step - 1e-6)
