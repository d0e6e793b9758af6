"""Light that is lost at the walls between facets of different height, and the heights that lose least.

With cells along eye rays, no wall is seen from outside. Inside the slab a ray drifts sideways; where it drifts toward a
neighbour whose edge is lower, it meets the wall above that edge and is lost for the picture. An edge of step s and
outward drift t (mm sideways per mm down) thus darkens a strip of width ``t * s`` on the higher side. Where the
neighbour is higher, the ray passes on through the solid and nothing is lost: the loss is one-sided. It may pass on as
far as the diagonal facet: a corner that is s higher than that one's, with drifts t and u toward both its edges, darkens
``t * u * s^2``.

Edges are numbered 0: +x (right), 1: +y (up), 2: -x (left), 3: -y (down); points run along +x or +y. Corner e lies
between edges e and e + 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads

RIGHT, UP, LEFT, DOWN = 0, 1, 2, 3
DOWNWARD, RIGHTWARD = (0, -1, 0, 1), (1, 0, -1, 0)
"""Rows and columns from a facet to its neighbour across each edge; to the diagonal facet, those of two edges."""


class Edges(NamedTuple):
    """Facets' edges, Q points each.

    Args:
        profiles: (..., 4, Q) heights relative to the facet's, mm.
        drifts: (..., 4, Q) outward drifts, mm sideways per mm down, at least 0.
    """

    profiles: FloatArray
    drifts: FloatArray


class EnergyTerms(NamedTuple):
    """What steps between facets cost, as a share of a facet's light.

    Args:
        loss: cost of a facet's light if all of it is lost.
        pitch: side of a facet, mm.
        even: cost of a squared step, lost light or not, per mm^2 and edge.
        screening: cost of a facet's squared height, per mm^2.
    """

    loss: float
    pitch: float
    even: float
    screening: float


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
def best_height(own, around, terms, low, high):
    """The height at which a facet costs least, and that cost.

    ``E(c) = sum over edges of mean over points of (loss * lost width / pitch + even * step^2) + sum over corners of
    loss * lost area / pitch^2 + screening * c^2``, the steps being ``own + c - around``. It is convex, so its
    derivative is bisected.

    Args:
        own: the facet's ``Edges`` (4, Q).
        around: (4, Q + 1, 2), see ``surroundings``.
        terms: what steps cost.
        low, high: bounds of the height, mm.
    """
    a, b = low, high
    points = own.profiles.shape[1]
    width, area = terms.loss / terms.pitch, terms.loss / terms.pitch**2
    c, cost = 0.0, 0.0
    for _ in range(18):
        c = 0.5 * (a + b)
        slope, cost = 2.0 * terms.screening * c, terms.screening * c * c
        for e in range(4):
            if not np.isnan(around[e, 0, 0]):
                for q in range(points):
                    step = own.profiles[e, q] + c - around[e, q, 0]
                    energy, pull = _pull(step, own.drifts[e, q], around[e, q, 1], width, terms.even)
                    slope += pull / points
                    cost += energy / points
            if not np.isnan(around[e, points, 0]):
                height, drift = _corner(own.profiles, own.drifts, e)
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
def surroundings(i, j, choice, heights, edges, around):
    """What faces facet (i, j) across its edges' points and, last in each row, its corners.

    Args:
        i, j: row and column of the facet.
        choice: (N, N) the facets' candidates.
        heights: (N, N) the facets' heights, mm.
        edges: the candidates' ``Edges`` (N, N, K, 4, Q).
        around: (4, Q + 1, 2) to fill with heights, nan outside the lens, and drifts toward the facet.
    """
    n, points = len(choice), edges.profiles.shape[4]
    around[:] = np.nan
    for e in range(4):
        r, c = i + DOWNWARD[e], j + RIGHTWARD[e]
        if 0 <= r < n and 0 <= c < n:
            k, facing = choice[r, c], (e + 2) % 4
            for q in range(points):
                around[e, q, 0] = edges.profiles[r, c, k, facing, q] + heights[r, c]
                around[e, q, 1] = edges.drifts[r, c, k, facing, q]
        r, c = r + DOWNWARD[(e + 1) % 4], c + RIGHTWARD[(e + 1) % 4]
        if 0 <= r < n and 0 <= c < n:
            k = choice[r, c]
            height, drift = _corner(edges.profiles[r, c, k], edges.drifts[r, c, k], (e + 2) % 4)
            around[e, points, 0], around[e, points, 1] = height + heights[r, c], drift


@njit(cache=True, nogil=True)
def _sweep_part(part, colour, state, candidates, terms, relief, chance, moved):
    """Part of the rows of a colour, see ``heat_bath_sweep``; state: choice and heights, chance: temperature and dice.

    candidates: errors and edges. moved: (N,) greatest change of a height per row, updated in place.
    """
    (choice, heights), (errors, edges), (temperature, dice) = state, candidates, chance
    n, _, labels = errors.shape
    around = np.zeros((4, edges.profiles.shape[4] + 1, 2))
    energy, level = np.zeros(labels), np.zeros(labels)
    for row in range(part.first, part.end):
        i = 2 * row + colour // 2
        level[:] = 0.0
        for j in range(colour % 2, n, 2):
            surroundings(i, j, choice, heights, edges, around)
            best = np.inf
            for k in range(labels):
                energy[k] = np.inf
                # far above the best candidate so far, the heat bath would not draw it
                if errors[i, j, k] < np.inf and errors[i, j, k] < best + 20.0 * temperature:
                    own = Edges(edges.profiles[i, j, k], edges.drifts[i, j, k])
                    reach = relief - np.abs(own.profiles).max()
                    if reach < 0.0:
                        continue
                    level[k], cost = best_height(own, around, terms, -reach, reach)
                    energy[k] = cost + errors[i, j, k]
                    best = min(best, energy[k])
            pick = _draw(energy, best, temperature, dice[i, j])
            moved[i] = max(moved[i], abs(heights[i, j] - level[pick]))
            choice[i, j], heights[i, j] = pick, level[pick]


def heat_bath_sweep(
    choice: IntArray,
    heights: FloatArray,
    errors: FloatArray,
    edges: Edges,
    terms: EnergyTerms,
    relief: float,
    temperature: float,
    dice: FloatArray,
) -> float:
    """One heat-bath sweep over all facets, no neighbours at once: each draws a candidate, and takes its best height.

    ``P(k) ~ exp(-E_k / temperature)`` with the candidate's image error plus its energy at its best height, see
    ``best_height``; temperature 0 takes the best.

    Args:
        choice: (N, N) int64, updated in place.
        heights: (N, N) mm, updated in place.
        errors: (N, N, K) image errors; inf where there is no candidate.
        edges: the candidates' ``Edges`` (N, N, K, 4, Q).
        terms: what steps cost.
        relief: candidates that rise or fall more than this, mm, are left out.
        temperature: same unit as the errors.
        dice: (N, N) random numbers in [0, 1).

    Returns:
        The greatest change of a height, mm.
    """
    n = len(choice)
    moved = np.zeros(n)
    state, candidates, chance = (choice, heights), (errors, edges), (temperature, dice)
    for colour in range(4):
        rows = (n + 1 - colour // 2) // 2
        in_threads(_sweep_part, rows, colour, state, candidates, terms, relief, chance, moved)
    return float(moved.max())


@njit(cache=True)
def _draw(energy, best, temperature, die):
    """A candidate by the heat bath, ``P(k) ~ exp((best - energy[k]) / temperature)``; die in [0, 1)."""
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


@njit(cache=True, nogil=True)
def _energy_part(part, choice, heights, errors, edges, terms, energies):
    """Part of the rows, see ``total_energy``; energies: (N, 3) zeros, to add to."""
    loss, pitch, even, screening = terms
    n, points = len(choice), edges.profiles.shape[4]
    around = np.zeros((4, points + 1, 2))
    for i in range(part.first, part.end):
        for j in range(n):
            k = choice[i, j]
            surroundings(i, j, choice, heights, edges, around)
            energies[i, 0] += errors[i, j, k]
            energies[i, 2] += screening * heights[i, j] ** 2
            for e in range(4):
                # both sides of every edge and corner are visited: count the own loss only, and half of the even part
                if not np.isnan(around[e, 0, 0]):
                    for q in range(points):
                        step = edges.profiles[i, j, k, e, q] + heights[i, j] - around[e, q, 0]
                        energies[i, 1] += loss / pitch * edges.drifts[i, j, k, e, q] * max(step, 0.0) / points
                        energies[i, 2] += 0.5 * even * step * step / points
                if not np.isnan(around[e, points, 0]):
                    height, drift = _corner(edges.profiles[i, j, k], edges.drifts[i, j, k], e)
                    step = height + heights[i, j] - around[e, points, 0]
                    energies[i, 1] += loss / pitch**2 * drift * max(step, 0.0) ** 2


def total_energy(
    choice: IntArray, heights: FloatArray, errors: FloatArray, edges: Edges, terms: EnergyTerms
) -> FloatArray:  # fmt: skip
    """(3,) image error, light lost at walls, and the even part (step^2 and screening), each summed over the lens.

    The lost light is ``loss * (drift * step / pitch, mean over an edge's points, + drift^2 * step^2 / pitch^2 of
    corners)``, for steps > 0. Arguments are those of ``heat_bath_sweep``.
    """
    energies = np.zeros((len(choice), 3))
    in_threads(_energy_part, len(choice), choice, heights, errors, edges, terms, energies)
    total: FloatArray = energies.sum(axis=0)
    return total
