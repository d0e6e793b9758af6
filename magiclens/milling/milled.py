"""What a mill makes of a solid: corners that its cutter does not reach, and polishing that evens out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from scipy.ndimage import distance_transform_edt, gaussian_filter, maximum_filter, minimum_filter

from magiclens.artifacts import FloatArray, Solid
from magiclens.fabrication.relief import top_relief
from magiclens.milling.border import outer, top_of
from magiclens.milling.cutter import Cutter
from magiclens.milling.outline import distance_at, rise_at
from magiclens.profiles.machines import Mill
from magiclens.slab import slab_under

PIXEL_MM, MOST_POINTS = 0.02, 32_000_000
"""Of the milled surface. Twice as wide pixels hide most of what a fine tip leaves at the foot of a step."""


def milled(solid: Solid, mill: Mill) -> Solid | None:
    """The slab that a mill makes of a solid with a grid, whatever its lines: its top sampled evenly, upright.

    None if the lens has too many pixels.

    Where the cutter does not fit, more stays standing than was designed: the grey-scale closing of the top by the
    cutter's shape. Polishing, a Gaussian, takes the ridges between lines away and rounds edges.
    """
    cutter = Cutter.model_validate(mill.tool)
    x0, x1, y0, y1 = outer(solid)
    x, y = (a + PIXEL_MM * np.arange(int((b - a) / PIXEL_MM) + 1) for a, b in ((x0, x1), (y0, y1)))
    if len(x) * len(y) > MOST_POINTS:
        return None
    upper = solid.faces[(solid.faces < top_of(solid)[..., 0].size).all(axis=1)]
    z = top_relief(Solid(solid.vertices, upper), x, y[::-1])
    beside = np.isnan(z)
    if beside.any():  # the outline leans with the rays it is cut along
        z = z[tuple(distance_transform_edt(beside, return_distances=False, return_indices=True))]
    shape = _shape(z, cutter.outline())
    z = -_dilated(-_dilated(z, shape), shape)
    if mill.polish > 0:
        z = gaussian_filter(z, mill.polish / PIXEL_MM, mode="nearest")
    return slab_under(x, y[::-1], z)


def _shape(z: FloatArray, outline: FloatArray) -> FloatArray:
    """(2 n + 1, 2 n + 1) float32: the cutter's height above its tip as far out as it may touch z; inf beyond."""
    reach = float(outline[5])
    while True:
        size = 2 * math.ceil(reach / PIXEL_MM) + 1
        rise = float((maximum_filter(z, size) - minimum_filter(z, size)).max())
        if (nearer := float(distance_at(outline, rise))) >= 0.9 * reach:
            break
        reach = nearer
    n = math.ceil(reach / PIXEL_MM)
    distances = PIXEL_MM * np.hypot(*np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1)))
    heights = [rise_at(outline, d) if d <= outline[5] else np.inf for d in distances.ravel()]
    return np.array(heights, np.float32).reshape(distances.shape)


@njit(cache=True, parallel=True)
def _dilated(z, shape):
    """The highest of z minus the shape, wherever the shape is put."""
    rows, columns = z.shape
    n = len(shape) // 2
    out = np.full_like(z, -np.inf)
    for each in prange(rows):
        row = np.int64(each)  # prange counts unsigned
        line = out[row]
        for a in range(-n, n + 1):
            if not 0 <= row + a < rows:
                continue
            for b in range(-n, n + 1):
                rise = shape[a + n, b + n]
                if rise == np.inf:
                    continue
                for column in range(max(0, -b), min(columns, columns - b)):
                    line[column] = max(line[column], z[row + a, column + b] - rise)
    return out
