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


_BISECTIONS = 18
"""Halvings of the range of heights: to 4e-5 mm of 10 mm."""
_FEW = 4
"""So many candidates are not worth the trouble of looking for their heights side by side."""


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


@njit(cache=True)
def _corner(profile, drift, e):
    """Height of a facet's corner, and the product of its drifts toward both edges."""
    f, last = (e + 1) % 4, profile.shape[1] - 1
    p, q = last if e in (RIGHT, DOWN) else 0, last if e in (RIGHT, UP) else 0
    return 0.5 * (profile[e, p] + profile[f, q]), drift[e, p] * drift[f, q]


@njit(cache=True)
def _slope(c, own, corners, around, terms):
    """Derivative of the energy of ``best_height`` at a height c; corners: (4, 2), see ``_corner``."""
    points = own.profiles.shape[1]
    width, area, even = terms.loss / terms.pitch, terms.loss / terms.pitch**2, terms.even
    slope = 2.0 * terms.screening * c
    for e in range(4):
        if not np.isnan(around[e, 0, 0]):
            for q in range(points):
                step = own.profiles[e, q] + c - around[e, q, 0]
                rate = width * own.drifts[e, q] if step > 0.0 else -width * around[e, q, 1]
                slope += (rate + 2.0 * even * step) / points
        if not np.isnan(around[e, points, 0]):
            step = corners[e, 0] + c - around[e, points, 0]
            slope += 2.0 * (area * (corners[e, 1] if step > 0.0 else around[e, points, 1])) * step
    return slope


@njit(cache=True)
def _cost(c, own, corners, around, terms):
    """The energy of ``best_height`` at a height c; corners: (4, 2), see ``_corner``."""
    points = own.profiles.shape[1]
    width, area, even = terms.loss / terms.pitch, terms.loss / terms.pitch**2, terms.even
    cost = terms.screening * c * c
    for e in range(4):
        if not np.isnan(around[e, 0, 0]):
            for q in range(points):
                step = own.profiles[e, q] + c - around[e, q, 0]
                rate = width * own.drifts[e, q] if step > 0.0 else -width * around[e, q, 1]
                cost += (rate * step + even * step * step) / points
        if not np.isnan(around[e, points, 0]):
            step = corners[e, 0] + c - around[e, points, 0]
            cost += area * (corners[e, 1] if step > 0.0 else around[e, points, 1]) * step * step
    return cost


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
    corners = np.empty((4, 2))
    for e in range(4):
        corners[e, 0], corners[e, 1] = _corner(own.profiles, own.drifts, e)
    for _ in range(_BISECTIONS - 1):
        c = 0.5 * (a + b)
        if _slope(c, own, corners, around, terms) > 0.0:
            b = c
        else:
            a = c
    c = 0.5 * (a + b)
    return c, _cost(c, own, corners, around, terms)


class _Lanes(NamedTuple):
    """Some candidates of a facet whose heights are sought side by side, as processors can; the last axis is theirs.

    Args:
        profiles, rates: (4, Q, M) heights of edges, and ``loss * drift / pitch``.
        corners: (4, 2, M) heights and products of drifts, see ``_corner``.
        low, high, height, slope: (M,) bounds, their middle, and the energy's derivative there.
    """

    profiles: FloatArray
    rates: FloatArray
    corners: FloatArray
    low: FloatArray
    high: FloatArray
    height: FloatArray
    slope: FloatArray


@njit(cache=True)
def _room(points, most):
    """Room for so many candidates side by side."""
    return _Lanes(
        np.zeros((4, points, most)), np.zeros((4, points, most)), np.zeros((4, 2, most)),
        np.zeros(most), np.zeros(most), np.zeros(most), np.zeros(most),
    )  # fmt: skip


@njit(cache=True)
def _fill_lane(lanes, m, own, terms, reach):
    """Make a candidate, with its edges ``own``, the m-th of those side by side."""
    points, width = own.profiles.shape[1], terms.loss / terms.pitch
    lanes.low[m], lanes.high[m] = -reach, reach
    for e in range(4):
        for q in range(points):
            lanes.profiles[e, q, m] = own.profiles[e, q]
            lanes.rates[e, q, m] = width * own.drifts[e, q]
        lanes.corners[e, 0, m], lanes.corners[e, 1, m] = _corner(own.profiles, own.drifts, e)


@njit(cache=True)
def _add_slopes(slope, height, profile, rate, facing):
    """Add what one point of an edge adds to the derivatives; facing: its height, rate, twice ``even``, and share."""
    other, inward, twice, share = facing
    for m in range(len(slope)):
        step = profile[m] + height[m] - other
        slope[m] += ((rate[m] if step > 0.0 else inward) + twice * step) * share


@njit(cache=True)
def _add_corner_slopes(slope, height, corner, facing):
    """Add what one corner adds to the derivatives; facing: its height, product of drifts, and loss by area."""
    other, inward, area = facing
    for m in range(len(slope)):
        step = corner[0, m] + height[m] - other
        slope[m] += 2.0 * (area * (corner[1, m] if step > 0.0 else inward)) * step


@njit(cache=True)
def _bisect(lanes, count, around, terms):
    """Find the heights of the first ``count`` candidates side by side: those that ``best_height`` finds, bit by bit."""
    points = lanes.profiles.shape[1]
    width, area = terms.loss / terms.pitch, terms.loss / terms.pitch**2
    low, high, height, slope = lanes.low[:count], lanes.high[:count], lanes.height[:count], lanes.slope[:count]
    share = 1.0 / points  # points are a power of two, so that this divides exactly
    for done in range(_BISECTIONS):
        if done > 0:
            for m in range(count):
                above = slope[m] > 0.0
                high[m] = height[m] if above else high[m]
                low[m] = low[m] if above else height[m]
        for m in range(count):
            height[m] = 0.5 * (low[m] + high[m])
            slope[m] = 2.0 * terms.screening * height[m]
        if done == _BISECTIONS - 1:
            return
        for e in range(4):
            if not np.isnan(around[e, 0, 0]):
                for q in range(points):
                    facing = (around[e, q, 0], -width * around[e, q, 1], 2.0 * terms.even, share)
                    _add_slopes(slope, height, lanes.profiles[e, q], lanes.rates[e, q], facing)
            if not np.isnan(around[e, points, 0]):
                facing_corner = (around[e, points, 0], around[e, points, 1], area)
                _add_corner_slopes(slope, height, lanes.corners[e], facing_corner)


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


@njit(cache=True)
def _weigh(candidates, around, terms, relief, temperature, lanes, found):
    """Fill in the energies of a facet's candidates, inf where the heat bath would not draw one, and their best heights.

    Args:
        candidates: errors (K,), profiles (K, 4, Q) and drifts.
        around: (4, Q + 1, 2), see ``surroundings``.
        terms, relief, temperature: see ``heat_bath_sweep``.
        lanes: room for K candidates.
        found: (K,) energies and heights; the height of a candidate that is not drawn stays.

    Returns:
        The least energy.
    """
    (errors, profiles, drifts), (energy, level) = candidates, found
    best, count, labels = np.inf, 0, len(errors)
    # which, and up to where: those that may be drawn, as far as the first that is looked at can tell
    which, known = np.empty(labels, np.int64), -1
    for k in range(labels):
        energy[k] = np.inf
        if errors[k] < np.inf and errors[k] < best + 20.0 * temperature:
            own = Edges(profiles[k], drifts[k])
            reach = relief - np.abs(own.profiles).max()
            if reach < 0.0:
                continue
            if known < 0:
                level[k], cost = best_height(own, around, terms, -reach, reach)
                best = energy[k] = cost + errors[k]
                known = k
            else:
                which[count] = k
                _fill_lane(lanes, count, own, terms, reach)
                count += 1
    if count > _FEW:
        _bisect(lanes, count, around, terms)
    for m in range(count):
        k = which[m]
        # far above the best candidate so far, the heat bath would not draw it
        if errors[k] < best + 20.0 * temperature:
            own = Edges(profiles[k], drifts[k])
            if count > _FEW:
                level[k] = lanes.height[m]
                cost = _cost(level[k], own, lanes.corners[:, :, m], around, terms)
            else:
                level[k], cost = best_height(own, around, terms, lanes.low[m], lanes.high[m])
            energy[k] = cost + errors[k]
            best = min(best, energy[k])
    return best


@njit(cache=True, nogil=True)
def _sweep_part(part, colour, state, candidates, terms, relief, chance, moved):
    """Part of the rows of a colour, see ``heat_bath_sweep``; state: choice and heights, chance: temperature and dice.

    candidates: errors and edges. moved: (N,) greatest change of a height per row, updated in place.
    """
    (choice, heights), (errors, edges), (temperature, dice) = state, candidates, chance
    n, _, labels = errors.shape
    points = edges.profiles.shape[4]
    around, lanes = np.zeros((4, points + 1, 2)), _room(points, labels)
    energy, level = np.zeros(labels), np.zeros(labels)
    for row in range(part.first, part.end):
        i = 2 * row + colour // 2
        level[:] = 0.0
        for j in range(colour % 2, n, 2):
            surroundings(i, j, choice, heights, edges, around)
            best = _weigh(
                (errors[i, j], edges.profiles[i, j], edges.drifts[i, j]),
                around,
                terms,
                relief,
                temperature,
                lanes,
                (energy, level),
            )
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
