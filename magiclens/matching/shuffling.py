"""Redrawing sub-regions by heat bath, so that walls between facets take less light; no place is ever taken twice."""

from __future__ import annotations

import numpy as np
from numba import njit

from magiclens.optics.walls import Edges, best_height, surroundings

REST = 1e-9
"""Pulls facets to the reference plane where their height makes no difference."""


@njit(cache=True)
def shuffle(chosen, owner, places, usable, edges, order, dice, temperature, terms, relief):
    """Sweeps over all facets; each draws anew among the labels whose place is free or its own, in place.

    chosen: (N, N) label of each facet. owner: (P,) facet that has a place, or -1. places: (N, N, K) and usable:
    (N, N, K): a label's place, and whether it may be taken. edges: (N, N, K, 4, Q), and terms: as in
    ``optics.walls``. order: (S, N * N) and dice: (S, N * N): facets in turn, and luck in [0, 1). A label is drawn
    with probability proportional to exp(-E / temperature), E its energy at its best height.
    """
    n = len(chosen)
    heights = np.zeros((n, n))
    around = np.zeros((4, edges.profiles.shape[4] + 1, 2))
    energy, level = np.zeros(places.shape[2]), np.zeros(places.shape[2])
    for s in range(len(order)):
        for t in range(n * n):
            f = order[s, t]
            i, j = f // n, f % n
            surroundings(i, j, chosen, heights, edges, around)
            for k in range(len(energy)):
                energy[k] = np.inf
                own = Edges(edges.profiles[i, j, k], edges.drifts[i, j, k])
                reach = relief - np.abs(own.profiles).max()
                taken = owner[places[i, j, k]] >= 0 and owner[places[i, j, k]] != f
                if usable[i, j, k] and not taken and reach >= 0.0:
                    level[k], energy[k] = best_height(own, around, terms, -reach, reach)
            if np.isfinite(energy.min()):
                k = _pick(energy, temperature, dice[s, t])
                owner[places[i, j, chosen[i, j]]] = -1
                owner[places[i, j, k]] = f
                chosen[i, j], heights[i, j] = k, level[k]


@njit(cache=True)
def _pick(energy, temperature, die):
    """A label by the heat bath; ``die`` in [0, 1) is luck. ``energy`` is overwritten."""
    energy[:] = np.exp((energy.min() - energy) / temperature)
    left = die * energy.sum()
    last = 0
    for k in range(len(energy)):
        if energy[k] > 0.0:
            left -= energy[k]
            last = k
            if left < 0.0:
                break
    return last
