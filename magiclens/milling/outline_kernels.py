"""Kernels on a cutter's outline: how high its surface is above its tip, and where a slope touches it."""

from __future__ import annotations

import math

from magiclens.kernels.compiler import njit

_WITHIN = 1.0 - 1e-12
"""A factor that keeps points on the rim from falling outside by rounding."""


@njit(cache=True)
def rise_at(outline, r):
    """Height of the cutter's surface above its tip, mm, at the distance ``r`` <= radius from its axis."""
    if r <= outline.flat:
        return 0.0
    if r <= outline.knee:
        beyond = r - outline.flat
        return outline.arc - math.sqrt(max(outline.arc * outline.arc - beyond * beyond, 0.0))
    return outline.rise + outline.slope * (r - outline.knee)


@njit(cache=True)
def distance_at(outline, rise):
    """How far from its axis, mm, the cutter's surface gets below a height above its tip: the inverse of ``rise_at``."""
    if rise <= 0.0:
        return outline.flat
    if rise < outline.rise:
        down = outline.arc - rise
        return outline.flat + math.sqrt(max(outline.arc * outline.arc - down * down, 0.0))
    if outline.slope == 0.0:
        return outline.radius
    return min(outline.knee + (rise - outline.rise) / outline.slope, outline.radius)


@njit(cache=True)
def touch(outline, slope, d):
    """Where a rising line touches a cutter: the v >= 0 at which rise(sqrt(d^2 + v^2)) - slope v is least.

    Seen from above, the line passes the axis at the distance d; v is measured along it, uphill, from the point that is
    nearest to the axis. On the arc v = slope sqrt((arc^2 - d^2) / (1 + slope^2)), on the cone of slope s
    v = slope d / sqrt(s^2 - slope^2); a line as steep as the cone touches at the rim only.

    Args:
        outline: the cutter's ``Outline``.
        slope: tangent of the line, >= 0.
        d: distance from the axis, mm, below the cutter's radius.
    """
    most = math.sqrt(max(outline.radius * outline.radius - d * d, 0.0)) * _WITHIN
    if outline.arc > 0.0:
        if d < outline.knee:
            v = slope * math.sqrt(max(outline.arc * outline.arc - d * d, 0.0)) / math.sqrt(1.0 + slope * slope)
            if d * d + v * v <= outline.knee * outline.knee:
                return min(v, most)
    elif d < outline.flat:
        # the rim of the flat end touches unless the line is steeper than the cone is there, along the line
        rim = math.sqrt(outline.flat * outline.flat - d * d)
        if slope <= outline.slope * rim / outline.flat:
            return rim
    if slope >= outline.slope:  # also without a cone, whose slope is then 0
        return most
    return min(slope * d / math.sqrt(outline.slope * outline.slope - slope * slope), most)


@njit(cache=True)
def touch_segment(outline, slope, length, along, d):
    """Where a cutter touches a rising segment: the way along it, and that point's distance from the cutter's axis.

    Args:
        outline: the cutter's ``Outline``.
        slope: tangent of the segment, >= 0.
        length: its length seen from above, mm.
        along: how far from its low end the axis is, along the segment, mm.
        d: how far the axis is beside the segment's line, mm.

    Returns:
        (v, r), mm; the segment is out of reach if r exceeds the cutter's radius.
    """
    v = min(max(along + touch(outline, slope, d), 0.0), length)
    return v, math.sqrt(d * d + (v - along) * (v - along))
