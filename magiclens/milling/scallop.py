"""Scallops: the ridges that a cutter leaves between lines."""

from __future__ import annotations

import math

from magiclens.milling.outline import Outline


def scallop_mm(outline: Outline, stepover_mm: float, slope: float = 0.0) -> float:
    """Height, measured upright, of the scallops that parallel lines leave on a plane.

    For a ball on a level plane this is the textbook's r - sqrt(r^2 - (s / 2)^2). Between two positions of the cutter
    the ridge is where both leave as much above the plane that they touch: rise(v) - slope v is the same at v and at
    v - stepover.

    Args:
        outline: the cutter's.
        stepover_mm: distance of the lines.
        slope: the plane's slope across the lines, a tangent.

    Returns:
        mm; inf if the cutter is narrower than the stepover and strips are left.
    """
    from magiclens.milling.outline_kernels import rise_at, touch

    if stepover_mm > 2 * outline.radius:
        return math.inf

    def left(v: float) -> float:
        return float(rise_at(outline, abs(v))) - slope * v if abs(v) <= outline.radius else math.inf

    deepest = float(touch(outline, slope, 0.0)) if slope else 0.0
    # the ridge is between the lowest points of two lines; what the nearer one leaves grows with v, the other's falls
    low, high = deepest, deepest + stepover_mm
    for _ in range(60):  # bisection, to the last bit
        middle = (low + high) / 2
        low, high = (middle, high) if left(middle) < left(middle - stepover_mm) else (low, middle)
    return max(left(low), left(high - stepover_mm)) - left(deepest)
