"""Light that is lost at the walls between facets of different height, and the heights that lose least.

Walls lie along eye rays, so none is seen from outside. Inside the slab a ray drifts sideways; where it drifts toward a
neighbour whose edge is lower, it meets the wall above that edge and is lost for the picture. An edge of step s and
outward drift t (mm sideways per mm down) thus darkens a strip of width ``t * s`` on the higher side. Where the
neighbour is higher, the ray passes on through the solid and nothing is lost: the loss is one-sided. It may pass on as
far as the diagonal facet: a corner that is s higher than that one's, with drifts t and u toward both its edges, darkens
``t * u * s^2``.

Edges are numbered 0: +x (right), 1: +y (up), 2: -x (left), 3: -y (down); profiles run along +x or +y. Corner e lies
between edges e and e + 1. ``profiles`` (..., 4, Q) are heights at the points of the edges, mm, relative to the facet's;
``drifts`` (..., 4, Q) >= 0 are outward, at the same points.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

RIGHT, UP, LEFT, DOWN = 0, 1, 2, 3
DOWNWARD, RIGHTWARD = (0, -1, 0, 1), (1, 0, -1, 0)
"""Rows and columns from a facet to its neighbour across each edge; to the diagonal facet, those of two edges."""


@njit(cache=True, inline="always")
def _pull(step, outward, inward, loss, even):
    """Energy of a step (own height minus neighbour's) and its derivative: one-sided loss plus ``even`` * step^2."""
    rate = loss * outward if step > 0.0 else -loss * inward
    return rate * step + even * step * step, rate + 2.0 * even * step


@njit(cache=True)
def _corner(profile, drift, e):
    """Height of a facet's corner, and the product of its drifts toward both edges."""
    f, last = (e + 1) % 4, profile.shape[1] - 1
    p, q = last if e in (RIGHT, DOWN) else 0, last if e in (RIGHT, UP) else 0
    return 0.5 * (profile[e, p] + profile[f, q]), drift[e, p] * drift[f, q]


@njit(cache=True)
def settle(own, outward, around, loss, pitch, even, screening, low, high):
    """The height at which a facet costs least, and that cost.

    own: (4, Q) its profiles, outward: (4, Q) its drifts. around: see ``surroundings``. The energy is the mean over an
    edge's points of ``loss * lost width / pitch + even * step^2``, summed over edges, plus ``loss * lost area /
    pitch^2`` of corners and ``screening * height^2``. low, high: bounds of the height. The energy is convex, so its
    derivative is bisected.
    """
    a, b = low, high
    points = own.shape[1]
    width, area = loss / pitch, loss / pitch**2
    c, cost = 0.0, 0.0
    for _ in range(18):
        c = 0.5 * (a + b)
        slope, cost = 2.0 * screening * c, screening * c * c
        for e in range(4):
            if not np.isnan(around[e, 0, 0]):
                for q in range(points):
                    step = own[e, q] + c - around[e, q, 0]
                    energy, pull = _pull(step, outward[e, q], around[e, q, 1], width, even)
                    slope += pull / points
                    cost += energy / points
            if not np.isnan(around[e, points, 0]):
                height, drift = _corner(own, outward, e)
                step = height + c - around[e, points, 0]
                rate = area * (drift if step > 0.0 else around[e, points, 1])
                slope += 2.0 * rate * step
                cost += rate * step * step
        if slope > 0.0:
            b = c
        else:
            a = c
    return c, cost


@njit(cache=True)
def surroundings(i, j, choice, heights, profiles, drifts, around):
    """What faces facet (i, j) across its edges' points and, last in each row, its corners.

    around: (4, Q + 1, 2) is filled with heights, nan outside the lens, and drifts toward the facet.
    """
    n, points = len(choice), profiles.shape[4]
    around[:] = np.nan
    for e in range(4):
        r, c = i + DOWNWARD[e], j + RIGHTWARD[e]
        if 0 <= r < n and 0 <= c < n:
            k, facing = choice[r, c], (e + 2) % 4
            for q in range(points):
                around[e, q, 0] = profiles[r, c, k, facing, q] + heights[r, c]
                around[e, q, 1] = drifts[r, c, k, facing, q]
        r, c = r + DOWNWARD[(e + 1) % 4], c + RIGHTWARD[(e + 1) % 4]
        if 0 <= r < n and 0 <= c < n:
            k = choice[r, c]
            height, drift = _corner(profiles[r, c, k], drifts[r, c, k], (e + 2) % 4)
            around[e, points, 0], around[e, points, 1] = height + heights[r, c], drift


@njit(cache=True, parallel=True)
def sweep(choice, heights, errors, profiles, drifts, loss, pitch, even, screening, relief, temperature, dice):
    """One heat-bath sweep over all facets, no neighbours at once: each draws a candidate, and takes its best height.

    choice: (N, N) int64 and heights: (N, N) mm, updated in place. errors: (N, N, K), inf: no candidate. profiles and
    drifts: (N, N, K, 4, Q); candidates that rise more than relief are out. dice: (N, N) in [0, 1). Candidate k is drawn
    with probability proportional to exp(-E_k / temperature); temperature 0 takes the best.
    Returns the change of the heights, mm.
    """
    n, _, labels = errors.shape
    moved = np.zeros(n)
    for colour in range(4):
        for row in prange((n + 1 - colour // 2) // 2):
            i = 2 * np.int64(row) + colour // 2  # prange counts unsigned, which would mix with signed numbers to floats
            around = np.zeros((4, profiles.shape[4] + 1, 2))
            energy, level = np.zeros(labels), np.zeros(labels)
            for j in range(colour % 2, n, 2):
                surroundings(i, j, choice, heights, profiles, drifts, around)
                best = np.inf
                for k in range(labels):
                    energy[k] = np.inf
                    if errors[i, j, k] < np.inf and errors[i, j, k] < best + 20.0 * temperature:
                        reach = relief - np.abs(profiles[i, j, k]).max()
                        if reach < 0.0:
                            continue
                        level[k], cost = settle(
                            profiles[i, j, k], drifts[i, j, k], around, loss, pitch, even, screening, -reach, reach
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
def total_energy(choice, heights, errors, profiles, drifts, loss, pitch, even, screening):
    """Image error, light lost at walls, and the even part (step^2 and screening), each summed over the lens."""
    n, points = len(choice), profiles.shape[4]
    parts = np.zeros((n, 3))
    for row in prange(n):
        i = np.int64(row)
        around = np.zeros((4, points + 1, 2))
        for j in range(n):
            k = choice[i, j]
            surroundings(i, j, choice, heights, profiles, drifts, around)
            parts[i, 0] += errors[i, j, k]
            parts[i, 2] += screening * heights[i, j] ** 2
            for e in range(4):
                # both sides of every edge and corner are visited: count the own loss only, and half of the even part
                if not np.isnan(around[e, 0, 0]):
                    for q in range(points):
                        step = profiles[i, j, k, e, q] + heights[i, j] - around[e, q, 0]
                        parts[i, 1] += loss / pitch * drifts[i, j, k, e, q] * max(step, 0.0) / points
                        parts[i, 2] += 0.5 * even * step * step / points
                if not np.isnan(around[e, points, 0]):
                    height, drift = _corner(profiles[i, j, k], drifts[i, j, k], e)
                    step = height + heights[i, j] - around[e, points, 0]
                    parts[i, 1] += loss / pitch**2 * drift * max(step, 0.0) ** 2
    return parts.sum(axis=0)
