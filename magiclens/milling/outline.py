"""Kernels on a cutter's outline: how high its surface stands above its tip, and where a slope touches it.

An outline is a float64 array (flat, round, slope, knee, rise, radius), mm: flat out to the distance ``flat`` from the
axis, then an arc of radius ``round`` out to the distance ``knee`` and the height ``rise``, then a cone of that
``slope`` out to ``radius``. It is convex; one of ``flat`` and ``round`` is zero.
"""

from __future__ import annotations

import math

from numba import njit

WITHIN = 1.0 - 1e-12
"""Keeps points on the rim from falling outside by rounding."""


@njit(cache=True)
def rise_at(outline, r):
    """Height of the cutter's surface above its tip at the distance ``r`` <= radius from its axis."""
    if r <= outline[0]:
        return 0.0
    if r <= outline[3]:
        beyond = r - outline[0]
        return outline[1] - math.sqrt(max(outline[1] * outline[1] - beyond * beyond, 0.0))
    return outline[4] + outline[2] * (r - outline[3])


@njit(cache=True)
def distance_at(outline, rise):
    """How far from its axis the cutter's surface gets below a height above its tip: the inverse of ``rise_at``."""
    if rise <= 0.0:
        return outline[0]
    if rise < outline[4]:
        down = outline[1] - rise
        return outline[0] + math.sqrt(max(outline[1] * outline[1] - down * down, 0.0))
    if outline[2] == 0.0:
        return outline[5]
    return min(outline[3] + (rise - outline[4]) / outline[2], outline[5])


@njit(cache=True)
def touch(outline, slope, d):
    """Where a line that climbs with ``slope`` >= 0 and passes the axis at the distance ``d`` < radius is touched.

    The way uphill from the point nearest to the axis; beyond ``radius`` the cutter has no surface.
    """
    flat, arc, steep, knee, radius = outline[0], outline[1], outline[2], outline[3], outline[5]
    most = math.sqrt(max(radius * radius - d * d, 0.0)) * WITHIN
    if arc > 0.0:
        if d < knee:
            v = slope * math.sqrt(max(arc * arc - d * d, 0.0)) / math.sqrt(1.0 + slope * slope)
            if d * d + v * v <= knee * knee:
                return min(v, most)
    elif d < flat:
        rim = math.sqrt(flat * flat - d * d)
        if slope <= steep * rim / flat:
            return rim
    if slope >= steep:
        return most
    return min(slope * d / math.sqrt(steep * steep - slope * slope), most)


@njit(cache=True)
def nearest(outline, slope, length, along, d):
    """(v, r): where a climbing segment is touched, as the way along it from its low end, and that point's distance
    from the axis, for an axis that is ``along`` the segment and ``d`` beside it; r > radius if it is out of reach.
    """
    v = min(max(along + touch(outline, slope, d), 0.0), length)
    return v, math.sqrt(d * d + (v - along) * (v - along))
