"""Counts, pixel by pixel, the facets whose patches cover a source."""

from __future__ import annotations

import math

import numpy as np

from magiclens.kernels.compiler import njit


@njit(cache=True)
def count_overlaps(patches, maps, half, size, side):
    """Count the facets that see each pixel of a source: pixel p is seen if M^-1 (p - landing) is in the facet's square.

    Args:
        patches: (F, 2) landing points of the facets' centres, mm, +y up; nan where light is reflected totally.
        maps: (F, 4) maps M of the facets, row-major.
        half: Half the side of a facet, mm.
        size: Side of the source, mm.
        side: Pixels along one side of the source.

    Returns:
        The counts, and the last facet that sees each pixel or -1; both (side, side) int32, row 0 at +y.
    """
    counts, last = np.zeros((side, side), np.int32), np.full((side, side), -1, np.int32)
    pixel = size / side
    for f in range(len(patches)):
        xx, xy, yx, yy = maps[f]
        determinant = xx * yy - xy * yx
        if determinant == 0.0 or math.isnan(determinant):
            continue
        wide, tall = half * (abs(xx) + abs(xy)), half * (abs(yx) + abs(yy))
        left, top = 0.5 * size + patches[f, 0], 0.5 * size - patches[f, 1]
        for r in range(max(int((top - tall) / pixel), 0), min(int((top + tall) / pixel) + 1, side)):
            for c in range(max(int((left - wide) / pixel), 0), min(int((left + wide) / pixel) + 1, side)):
                x, y = (c + 0.5) * pixel - left, top - (r + 0.5) * pixel
                u, v = (yy * x - xy * y) / determinant, (xx * y - yx * x) / determinant
                if -half <= u < half and -half <= v < half:
                    counts[r, c] += 1
                    last[r, c] = f
    return counts, last
