"""Samples the source as ideal facets would show it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.kernels.compiler import njit
from magiclens.kernels.sampling import clamped_cell, rotated_grid, weighted_light
from magiclens.kernels.uncounted import uncounted


class IdealFacets(NamedTuple):
    """What N x N facets show, in the image frame (y down), mm.

    A point p of a facet, from its centre, shows the source at ``landing + map p``, and is seen in the picture at a
    point q with ``p = inward (q - place)``.

    Attributes:
        landings: (N, N, 2), nan where light is reflected totally.
        maps: (N, N, 2, 2).
        places: (N, N, 2).
        inward: (N, N, 2, 2).
    """

    landings: np.ndarray
    maps: np.ndarray
    places: np.ndarray
    inward: np.ndarray


@njit(cache=True, forceinline=True)
def _facet_point(facets, i, j, x, y):
    """The point of facet (i, j), from its centre, that is seen at (x, y) from the picture's centre; mm."""
    u, v, m = x - facets.places[i, j, 0], y - facets.places[i, j, 1], facets.inward
    return m[i, j, 0, 0] * u + m[i, j, 0, 1] * v, m[i, j, 1, 0] * u + m[i, j, 1, 1] * v


@njit(cache=True, forceinline=True)
def _visible_facet(facets, size, x, y):
    """The facet that is seen at (x, y) mm from the picture's upper left corner, and the point of it.

    This is the facet in whose square (x, y) lies, unless parallax has moved it away and a neighbour is seen instead.
    """
    n = len(facets.places)
    half = 0.5 * size / n + 1e-9
    j, i = min(int(x / size * n), n - 1), min(int(y / size * n), n - 1)
    x, y = x - size / 2, y - size / 2
    u, v = _facet_point(facets, i, j, x, y)
    if abs(u) > half or abs(v) > half:
        near_j = min(max(j + (u > half) - (u < -half), 0), n - 1)
        near_i = min(max(i + (v > half) - (v < -half), 0), n - 1)
        a, b = _facet_point(facets, near_i, near_j, x, y)
        if abs(a) <= half and abs(b) <= half:
            return near_i, near_j, a, b
    return i, j, u, v


@njit(cache=True, nogil=True)
def sample_ideal_picture(rows_of_picture, source, per_mm, facets, size, samples, out):
    """The mean over samples q of a pixel of ``source(landing + map p)``, where facet point p is seen at q.

    Args:
        rows_of_picture: A ``LoopPart`` of the rows.
        source: (H, W, C) float32, linear light; C is 1 or 3.
        per_mm: Pixels of the source per mm.
        facets: What the facets show, see ``IdealFacets``.
        size: Side of the picture, mm.
        samples: Samples per side of a pixel.
        out: (R, R, C) float32, whose rows are filled.
    """
    source, facets, out = uncounted(source), uncounted(facets), uncounted(out)
    rows, columns, channels = source.shape
    values, resolution = source.reshape(-1), len(out)
    pixel = size / resolution
    share, places = 1 / samples**2, np.zeros((samples * samples, 2))
    for k in range(samples * samples):
        places[k, 0], places[k, 1] = rotated_grid(k, samples)
    for r in range(rows_of_picture.first, rows_of_picture.end):
        for c in range(resolution):
            red = green = blue = np.float32(0)
            for k in range(samples * samples):
                right, down = places[k, 0], places[k, 1]
                i, j, u, v = _visible_facet(facets, size, (c + right) * pixel, (r + down) * pixel)
                at, m = facets.landings, facets.maps
                if math.isnan(at[i, j, 0]):
                    continue
                sx = (at[i, j, 0] + m[i, j, 0, 0] * u + m[i, j, 0, 1] * v) * per_mm + columns / 2 - 0.5
                sy = (at[i, j, 1] + m[i, j, 1, 0] * u + m[i, j, 1, 1] * v) * per_mm + rows / 2 - 0.5
                if not (-0.5 <= sx <= columns - 0.5 and -0.5 <= sy <= rows - 0.5):
                    continue  # beside the source it is dark
                ix, iy, fx, fy = clamped_cell(sx, sy, columns, rows)
                light = weighted_light(values, columns, channels, iy, ix, fx, fy, share)
                red, green, blue = red + light[0], green + light[1], blue + light[2]
            out[r, c, 0] = red
            if channels == 3:
                out[r, c, 1], out[r, c, 2] = green, blue
