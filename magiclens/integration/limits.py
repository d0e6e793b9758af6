"""Limits of rises between vertices: what one has in excess over its neighbour is taken from both alike."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray

_MOST_PASSES_OF_STEPS = 500
"""Passes over all walls, at most, that limit the steps."""
_ENOUGH_MM = 1e-6
"""Excess of a step over its limit that is not worth another pass, mm."""
_MOST_PASSES_OF_RISES = 60
"""Passes over the whole grid, at most, that limit the rises between neighbours."""
_ENOUGH_OF_RISES = 1e-4
"""Excess of a rise over its limit, relative to that, that is not worth another pass."""


def limit_steps(heights: FloatArray, limit: float) -> FloatArray:
    """Heights of which no step across a wall exceeds a limit, for tools that cannot cut steep walls.

    What a step has in excess is taken from the border vertices on both sides alike, so that only the outermost
    micro-facets next to too high a step change their slope. Corner vertices have two steps each: passes alternate.

    Args:
        heights: (N, N, k, k) mm.
        limit: largest step that is left, mm.

    Returns:
        (N, N, k, k) heights, mm.
    """
    h = heights.copy()
    for _ in range(_MOST_PASSES_OF_STEPS):
        # slightly below the limit: what the last pass leaves is then still within it
        excess = max(
            _share_excess(h[:, :-1, :, -1], h[:, 1:, :, 0], limit - _ENOUGH_MM),
            _share_excess(h[:-1, :, -1, :], h[1:, :, 0, :], limit - _ENOUGH_MM),
        )
        if excess <= _ENOUGH_MM:
            break
    return h


def limit_rises(heights: FloatArray, limit: float) -> FloatArray:
    """Heights (G, G), mm, of which neighbours differ by no more than a limit, mm."""
    h = np.array(heights)
    for _ in range(_MOST_PASSES_OF_RISES):
        # even and odd pairs in turn, so that no vertex is moved twice at once
        pairs = [(along[first:-1:2], along[first + 1 :: 2]) for along in (h, h.T) for first in (0, 1)]
        if max(_share_excess(one, other, limit) for one, other in pairs) < _ENOUGH_OF_RISES * limit:
            break
    return h


def _share_excess(one: FloatArray, other: FloatArray, limit: float) -> float:
    """Take the excess of the steps between facing border vertices from both, in place; returns the largest, mm.

    Args:
        one: heights of border vertices, mm; a view into all heights.
        other: heights of the vertices across the wall, mm, of the same shape; such a view too.
        limit: largest step that is left, mm.
    """
    step = one - other
    excess = np.sign(step) * np.maximum(np.abs(step) - limit, 0.0)
    one -= 0.5 * excess
    other += 0.5 * excess
    return float(np.abs(excess).max(initial=0.0))
