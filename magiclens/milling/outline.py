"""A cutter's outline as numbers that kernels take."""

from __future__ import annotations

from typing import NamedTuple


class Outline(NamedTuple):
    """Half of a cutter's cross-section: how high its surface is above its tip, at each distance from its axis, mm.

    From the axis outwards the surface is flat, then an arc, then a cone. It is convex. Either ``flat`` or ``arc`` is 0.

    Attributes:
        flat: distance from the axis at which the flat end stops.
        arc: radius of the arc that follows.
        slope: slope (a tangent) of the cone; 0 if there is none.
        knee: distance from the axis at which the arc ends and the cone begins.
        rise: height of the knee above the tip.
        radius: distance from the axis at which the cutter ends.
    """

    flat: float
    arc: float
    slope: float
    knee: float
    rise: float
    radius: float
