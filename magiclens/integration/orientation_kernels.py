"""The rises along mesh edges that facets need, compiled (4.3)."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.optics.eyes import height_gradient, project, surface_point
from magiclens.optics.medium import Optics
from magiclens.optics.refraction import facet_normal


@njit(cache=True, nogil=True)
def _rises_part(part, heights, centres, patches, side, optics, rises):
    """Part of the facets, see ``rises_along_edges``; patches: offsets and maps. rises: to fill."""
    (offsets, maps), (along_u, along_v, clamped) = patches, rises
    k = heights.shape[1]
    m = k - 1
    d = side / m
    for f in range(part.first, part.end):
        centre = centres[f]
        for a in range(k):
            for b in range(k):
                u, v = centre[0] - 0.5 * side + b * d, centre[1] + 0.5 * side - a * d
                if b < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a, b + 1])
                    g, _, bad = _slope(u + 0.5 * d, v, h, centre, offsets[f], maps[f], optics)
                    along_u[f, a, b] = g * d
                    clamped[f] += bad
                if a < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a + 1, b])
                    _, g, bad = _slope(u, v - 0.5 * d, h, centre, offsets[f], maps[f], optics)
                    along_v[f, a, b] = -g * d  # rows go down, v goes up
                    clamped[f] += bad


def rises_along_edges(
    heights: FloatArray, centres: FloatArray, offsets: FloatArray, maps: FloatArray, side: float, optics: Optics
) -> tuple[FloatArray, FloatArray, IntArray]:  # fmt: skip
    """``rise = slope at the edge's middle * its length``, along all mesh edges of all facets.

    Args:
        heights: (F, k, k) where the surface is now, mm.
        centres: (F, 2) mm.
        offsets: (F, 2) of the facets' patches, mm.
        maps: (F, 3) of the facets' patches, as (xx, xy, yy).
        side: from a facet's first vertex to its last, mm.
        optics: an ``optics.medium.Optics``.

    Returns:
        (F, k, k - 1) rises along rows, from column b to b + 1, mm; (F, k - 1, k) along columns, from row a, which is
        further up, to a + 1, mm; (F,) how many edges were held at the slope limit.
    """
    facets, k, _ = heights.shape
    rises = (np.zeros((facets, k, k - 1)), np.zeros((facets, k - 1, k)), np.zeros(facets, np.int64))
    in_threads(_rises_part, facets, heights, centres, (offsets, maps), side, optics, rises)
    return rises


@njit(cache=True)
def _slope(u, v, h, centre, offset, m, optics):
    """dh/du and dh/dv at a point of the surface, and whether the slope limit was hit.

    The reference eye sees the point at q of the reference plane, and shall see ``c + R + M (q - c)`` of the source
    there; that gives the normal, ``optics.refraction.facet_normal``, and the normal gives the slopes. A normal with
    ``n_z < cos_limit`` is turned upright until it meets the limit.

    Args:
        u: of the point on the reference plane, mm.
        v: the same along +y, mm.
        h: its height, mm.
        centre: (2,) c of the facet, mm.
        offset: (2,) R of the facet's patch, mm.
        m: (3,) M of the facet's patch as (xx, xy, yy).
        optics: an ``optics.medium.Optics``.

    Returns:
        dh/du, dh/dv, and whether the slope was held at its limit.
    """
    point = surface_point(optics, u, v, h, optics.depth)
    # the eye sees the surface point where its ray crosses the reference plane: that is the point of the tile
    x, y = project(optics.eye, point, optics.depth)
    px, py = x - centre[0], y - centre[1]
    sx = centre[0] + offset[0] + m[0] * px + m[1] * py
    sy = centre[1] + offset[1] + m[1] * px + m[2] * py
    nx, ny, nz = facet_normal(optics.eye, point, (sx, sy), optics)
    cos_limit = optics.cos_limit
    clamped = nz < cos_limit
    if clamped:
        side = math.sqrt((1.0 - cos_limit * cos_limit) / max(nx * nx + ny * ny, 1e-30))
        nx, ny, nz = nx * side, ny * side, cos_limit
    gu, gv = height_gradient(optics, u, v, (nx, ny, nz), optics.depth)
    return gu, gv, clamped
