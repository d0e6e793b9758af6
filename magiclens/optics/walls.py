"""Light that is lost at the walls between facets of different height, and the heights that lose least.

Walls lie along eye rays, so none is seen from outside. Inside the slab a ray drifts sideways; where it drifts toward a
neighbour whose edge is lower, it meets the wall above that edge and is lost for the picture. An edge of step s and
outward drift t (mm sideways per mm down) thus darkens a strip of width ``t * s`` on the higher side. Where the
neighbour is higher, the ray passes on through the solid and nothing is lost: the loss is one-sided.

Edges are numbered 0: +x (right), 1: +y (up), 2: -x (left), 3: -y (down); profiles run along +x or +y.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

RIGHT, UP, LEFT, DOWN = 0, 1, 2, 3


@njit(cache=True, inline="always")
def _pull(step, outward, inward, loss, even):
    """Energy of a step (own height minus neighbour's) and its derivative: one-sided loss plus ``even`` * step^2."""
    rate = loss * outward if step > 0.0 else -loss * inward
    return rate * step + even * step * step, rate + 2.0 * even * step


@njit(cache=True)
def settle(own, outward, others, inward, loss, even, screening, low, high):
    """The height at which a facet costs least, and that cost.

    own: (4, Q) its edge profiles relative to its height. others: (4, Q) heights of the neighbours' edges facing it
    (nan: none). outward, inward: (4,) drift of own rays toward each edge, of the neighbour's rays toward the same edge.
    The energy is the mean over an edge's points of ``loss * lost width + even * step^2``, summed over edges, plus
    ``screening * height^2``. low, high: bounds of the height. The energy is convex, so its derivative is bisected.
    """
    a, b = low, high
    points = own.shape[1]
    cost = 0.0
    for _ in range(18):
        c = 0.5 * (a + b)
        slope, cost = 2.0 * screening * c, screening * c * c
        for e in range(4):
            if others[e, 0] != others[e, 0]:
                continue
            for q in range(points):
                energy, pull = _pull(own[e, q] + c - others[e, q], outward[e], inward[e], loss, even)
                slope += pull / points
                cost += energy / points
        if slope > 0.0:
            b = c
        else:
            a = c
    return c, cost


@njit(cache=True)
def surroundings(i, j, choice, heights, profiles, drifts, others, inward):
    """Edges that face facet (i, j): ``others`` (4, Q) heights, nan outside the lens, and ``inward`` (4,) drifts."""
    n = len(choice)
    others[:] = np.nan
    inward[:] = 0.0
    for e in range(4):
        r = i - 1 if e == UP else (i + 1 if e == DOWN else i)
        c = j + 1 if e == RIGHT else (j - 1 if e == LEFT else j)
        if 0 <= r < n and 0 <= c < n:
            k, facing = choice[r, c], (e + 2) % 4
            inward[e] = drifts[r, c, k, facing]
            for q in range(others.shape[1]):
                others[e, q] = profiles[r, c, k, facing, q] + heights[r, c]


@njit(cache=True, parallel=True)
def sweep(choice, heights, errors, profiles, drifts, loss, even, screening, relief, temperature, dice):
    """One heat-bath sweep over all facets, checkerboard order: each draws a candidate, and takes its best height.

    choice: (N, N) int64 and heights: (N, N) mm, updated in place. errors: (N, N, K), inf: no candidate. profiles:
    (N, N, K, 4, Q) mm; candidates that rise more than relief are out. drifts: (N, N, K, 4) >= 0. dice: (N, N) in
    [0, 1). Candidate k is drawn with probability proportional to exp(-E_k / temperature); temperature 0 takes the best.
    Returns the change of the heights, mm.
    """
    n, _, labels = errors.shape
    moved = np.zeros(n)
    for colour in range(2):
        for row in prange(n):
            i = np.int64(row)  # prange counts unsigned, which would mix with signed numbers to floats
            others, inward = np.zeros((4, profiles.shape[4])), np.zeros(4)
            energy, level = np.zeros(labels), np.zeros(labels)
            for j in range((i + colour) % 2, n, 2):
                surroundings(i, j, choice, heights, profiles, drifts, others, inward)
                best = np.inf
                for k in range(labels):
                    energy[k] = np.inf
                    if errors[i, j, k] < np.inf and errors[i, j, k] < best + 20.0 * temperature:
                        reach = relief - np.abs(profiles[i, j, k]).max()
                        if reach < 0.0:
                            continue
                        level[k], cost = settle(
                            profiles[i, j, k], drifts[i, j, k], others, inward, loss, even, screening, -reach, reach
                        )
                        energy[k] = cost + errors[i, j, k]
                        best = min(best, energy[k])
                pick = _draw(energy, best, temperature, dice[i, j])
                moved[i] = max(moved[i], abs(heights[i, j] - level[pick]))
                choice[i, j], heights[i, j] = pick, level[pick]
    return moved.max()


@njit(cache=True)
def _draw(energy, best, temperature, die):
    if temperature <= 0.0:
        return np.argmin(energy)
    total = 0.0
    for e in energy:
        total += np.exp((best - e) / temperature)
    left = die * total
    for k in range(len(energy)):
        left -= np.exp((best - energy[k]) / temperature)
        if left <= 0.0:
            return k
    return np.argmin(energy)


@njit(cache=True, parallel=True)
def total_energy(choice, heights, errors, profiles, drifts, loss, even, screening):
    """Image error, light lost at walls, and the even part (step^2 and screening), each summed over the lens."""
    n = len(choice)
    parts = np.zeros((n, 3))
    for row in prange(n):
        i = np.int64(row)
        others, inward = np.zeros((4, profiles.shape[4])), np.zeros(4)
        for j in range(n):
            k = choice[i, j]
            surroundings(i, j, choice, heights, profiles, drifts, others, inward)
            parts[i, 0] += errors[i, j, k]
            parts[i, 2] += screening * heights[i, j] ** 2
            for e in range(4):
                if others[e, 0] != others[e, 0]:
                    continue
                for q in range(others.shape[1]):
                    step = profiles[i, j, k, e, q] + heights[i, j] - others[e, q]
                    # both sides of every edge are visited: count the own loss only, and half of the even part
                    parts[i, 1] += loss * drifts[i, j, k, e] * max(step, 0.0) / others.shape[1]
                    parts[i, 2] += 0.5 * even * step * step / others.shape[1]
    return parts.sum(axis=0)
