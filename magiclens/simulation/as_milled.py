"""The lens as a mill makes it: corners that its cutter does not reach, and polishing that evens out."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, maximum_filter, minimum_filter

from magiclens.contract.artifacts import FloatArray, Scene, Solid
from magiclens.geometry.columns import top_heights
from magiclens.geometry.solid import solid_from_raster
from magiclens.milling.border import outer_rectangle, top_vertices
from magiclens.milling.cutter import Cutter
from magiclens.milling.outline import Outline
from magiclens.milling.outline_kernels import distance_at, rise_at
from magiclens.profiles.machines import Mill
from magiclens.simulation.as_milled_kernels import dilated
from magiclens.simulation.strips import points_of, seen_in_strips

_PER_SIGMA = 1.6
"""Pitch of the surface that eyes look through, in sigmas of polishing. A wider one would widen the error at the foot of
a step."""
_MOST_POINTS, _MOST_IN_A_BODY = 400_000_000, 32_000_000
"""Most points of a surface that is traced in strips, and of one that is held in one piece."""
COARSE_MM = 0.02
"""Pitch of the surface that is held in one piece."""


def as_milled(solid: Solid, mill: Mill) -> Solid | None:
    """The closed body that a mill makes of a solid with a grid: its top sampled every 0.02 mm, vertical cells.

    None if that are too many points. See ``milled_surface``; this is coarser than what ``seen_as_milled`` looks at.
    """
    if points_of(solid, (COARSE_MM, COARSE_MM)) > _MOST_IN_A_BODY:
        return None
    x0, x1, y0, y1 = outer_rectangle(solid)
    x, y = (np.arange(a, b, COARSE_MM) for a, b in ((x0, x1), (y0, y1)))
    return solid_from_raster(x, y[::-1], milled_surface(solid, mill, x, y[::-1]))


def seen_as_milled(scene: Scene, solid: Solid, mill: Mill) -> list[FloatArray] | None:
    """Per view (R, R, C) float32, linear light: what eyes see of a lens as milled. None if it has too many points."""
    pixel = _PER_SIGMA * mill.polish_mm
    if points_of(solid, (pixel, pixel)) > _MOST_POINTS:
        return None
    surface = partial(milled_surface, solid, mill)
    return seen_in_strips(scene, solid, lambda x, y: [surface(x, y)], (pixel, pixel))[0]


def milled_surface(solid: Solid, mill: Mill, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """What a mill makes of a solid's top, whatever the lines of its program.

    Where the cutter does not fit, more stays standing than was designed: the grey-scale closing of the top by the
    cutter's shape. Polishing, a Gaussian, takes the ridges between lines away and rounds edges.

    Args:
        solid: with a grid, lens frame.
        mill: its cutter and polishing count.
        x_mm: (columns,) ascending over the whole of the top, evenly spaced.
        y_mm: (rows,) descending, with the same spacing.

    Returns:
        (rows, columns) float32, z, mm, lens frame.
    """
    outline, pixel = Cutter.model_validate(mill.tool).outline(), float(x_mm[1] - x_mm[0])
    top = top_vertices(solid)
    upper = solid.faces[(solid.faces < top[..., 0].size).all(axis=1)]
    steep = float(np.ptp(top[..., 2]))
    reach = min(outline.radius, float(distance_at(outline, steep)), 25 * pixel)
    # closing looks twice as far as the cutter reaches, and the Gaussian ends at four sigmas
    around = math.ceil((2 * reach + 4 * mill.polish_mm) / pixel)
    before, after = (y_mm[0] + pixel * np.arange(around, 0, -1), y_mm[-1] - pixel * np.arange(1, around + 1))
    z = top_heights(Solid(solid.vertices, upper), x_mm, np.concatenate([before, y_mm, after]))
    beside = np.isnan(z)
    if beside.any():  # the outline leans with the rays it is cut along
        z = z[tuple(distance_transform_edt(beside, return_distances=False, return_indices=True))]
    shape = _shape(z, outline, pixel)
    z = -dilated(-dilated(z, shape), shape)
    z = gaussian_filter(z, mill.polish_mm / pixel, mode="nearest")
    return np.ascontiguousarray(z[around : around + len(y_mm)])


def _shape(z: FloatArray, outline: Outline, pixel_mm: float) -> FloatArray:
    """(2 n + 1, 2 n + 1) float32: the cutter's height above its tip as far out as it may touch z; inf beyond."""
    reach = outline.radius
    while True:
        size = 2 * math.ceil(reach / pixel_mm) + 1
        rise = float((maximum_filter(z, size) - minimum_filter(z, size)).max())
        if (nearer := float(distance_at(outline, rise))) >= 0.9 * reach:
            break
        reach = nearer
    n = math.ceil(reach / pixel_mm)
    distances = pixel_mm * np.hypot(*np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1)))
    heights = [rise_at(outline, d) if d <= outline.radius else np.inf for d in distances.ravel()]
    return np.array(heights, np.float32).reshape(distances.shape)
