"""Bounding the steps between facets, for tools that cannot cut a cliff."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray

PASSES = 500
_ENOUGH_MM = 1e-6


def limit_steps(heights: FloatArray, limit: float) -> FloatArray:
    """(N, N, k, k) heights of which no step across a wall exceeds ``limit`` mm.

    What a step has in excess is taken from the border vertices on both sides alike, so that only the outermost
    micro-facets next to too high a step change their slope. Corner vertices have two steps each: passes alternate.
    """
    h = heights.copy()
    for _ in range(PASSES):
        excess = max(
            _share(h[:, :-1, :, -1], h[:, 1:, :, 0], limit - _ENOUGH_MM),
            _share(h[:-1, :, -1, :], h[1:, :, 0, :], limit - _ENOUGH_MM),
        )
        if excess <= _ENOUGH_MM:
            break
    return h


def _share(one: FloatArray, other: FloatArray, limit: float) -> float:
    """Take the excess of the steps between facing border vertices from both, in place; returns the largest, mm."""
    step = one - other
    excess = np.sign(step) * np.maximum(np.abs(step) - limit, 0.0)
    one -= 0.5 * excess
    other += 0.5 * excess
    return float(np.abs(excess).max(initial=0.0))
