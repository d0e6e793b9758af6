"""The rises along mesh edges that facets need, compiled (4.3)."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.optics.lenslets import facet_slope
from magiclens.optics.medium import Optics


@njit(cache=True, nogil=True)
def _rises_part(part, heights, centres, patches, side, optics, rises):
    """Part of the facets, see ``rises_along_edges``; patches: offsets and maps. rises: to fill."""
    (offsets, maps), (along_u, along_v, clamped) = patches, rises
    k = heights.shape[1]
    m = k - 1
    d = side / m
    for f in range(part.first, part.end):
        centre, offset = (centres[f, 0], centres[f, 1]), (offsets[f, 0], offsets[f, 1])
        map_ = (maps[f, 0], maps[f, 1], maps[f, 2])
        for a in range(k):
            for b in range(k):
                u, v = centre[0] - 0.5 * side + b * d, centre[1] + 0.5 * side - a * d
                if b < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a, b + 1])
                    g, _, bad = facet_slope(u + 0.5 * d, v, h, centre, offset, map_, optics)
                    along_u[f, a, b] = g * d
                    clamped[f] += bad
                if a < m:
                    h = 0.5 * (heights[f, a, b] + heights[f, a + 1, b])
                    _, g, bad = facet_slope(u, v - 0.5 * d, h, centre, offset, map_, optics)
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
