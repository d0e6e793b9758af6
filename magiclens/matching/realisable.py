"""Which patches facets can really show: within the slope limit, and no taller than the relief."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from magiclens.matching.search import reachable
from magiclens.optics.refraction import facet_normal

ROUNDS = 4
"""Of slopes and heights that depend on each other."""


@njit(cache=True, parallel=True)
def realisable(centres, offsets, maps, pitch, optics, relief):
    """(F, D^2, 4): can a facet show its neighbouring sub-regions with each map, below the slope limit and the relief?

    centres: (F, 2), offsets: (D^2, 2), maps: (4, 2) xx and yy; mm, image frame (y down).
    """
    out = np.zeros((len(centres), len(offsets), 4), np.bool_)
    for f in prange(len(centres)):
        cx, cy = centres[f, 0], centres[f, 1]
        for k in range(len(offsets)):
            rx, ry = offsets[k, 0], offsets[k, 1]
            for s in range(4):
                out[f, k, s] = reachable(
                    (cx, cy), (rx, ry), (maps[s, 0], 0.0, maps[s, 1]), 0.5 * pitch, optics
                ) and relief >= _tallest((cx, cy), (rx, ry), (maps[s, 0], maps[s, 1]), 0.5 * pitch, optics)
    return out


@njit(cache=True)
def _tallest(centre, offset, m, half, optics):
    """How far the corners of a lenslet rise or fall from its mean, mm; its slope is taken to be linear to the corners.

    Where the surface lies lower, it must be steeper: the heights at which slopes are taken are iterated.
    """
    (cx, cy), (rx, ry), (xx, yy), eye = centre, offset, m, optics.eye
    far = eye[2] - optics.depth
    slopes, rises = np.zeros((5, 2)), np.zeros(5)
    for _ in range(ROUNDS):
        for k in range(5):
            px = 0.0 if k == 4 else (half if k & 1 else -half)
            py = 0.0 if k == 4 else (half if k & 2 else -half)
            x, y, z = cx + px, cy + py, optics.depth + rises[k]
            lean_x, lean_y = (0.0, 0.0) if optics.vertical else ((x - eye[0]) / far, (y - eye[1]) / far)
            sx, sy = x + rx + (xx - 1.0) * px, y + ry + (yy - 1.0) * py
            nx, ny, nz = facet_normal(eye, (x - lean_x * rises[k], y - lean_y * rises[k], z), (sx, sy), optics)
            along = nx * lean_x + ny * lean_y - nz
            slopes[k, 0], slopes[k, 1] = nx / along, ny / along
        for k in range(4):
            px, py = half if k & 1 else -half, half if k & 2 else -half
            rises[k] = 0.5 * ((slopes[4, 0] + slopes[k, 0]) * px + (slopes[4, 1] + slopes[k, 1]) * py)
        # the mean of a quadratic over the square is a third of its mean over the corners
        rises[4] = 0.0
        rises -= rises[:4].mean() / 3.0
    return np.abs(rises).max()
