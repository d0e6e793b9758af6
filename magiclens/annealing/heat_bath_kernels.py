"""Sweeps of the heat bath: all candidates of a facet are weighed side by side, each at its best height.

The best height of a candidate is that of ``optics.walls.best_height``, found by bisection. Processors do equal work on
neighbouring numbers at once, so candidates are worked on in groups, and numbers of a group lie side by side: what is
called a row here. They stay in registers, since all loops over edges, points and candidates have constant lengths.
"""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.geometry.facets import EDGE_POINTS
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.optics.walls import DOWN, DOWNWARD, RIGHT, RIGHTWARD, UP, Edges, EnergyTerms

_GROUP = 16
"""Candidates in a group: as many float32 as the widest registers hold."""
_BISECTIONS = 14
"""Halvings of the range of heights in which the best must be: to 6e-5 of it."""
_FEWER_OPERATIONS = {"contract", "nsz", "nnan", "ninf"}
"""No number that is compared or added is infinite or nan, and products may be added without rounding them first."""

_POINTS = 4 * EDGE_POINTS
# where rows of a group's table begin: profiles at the points of edges, mm; outward drifts of edges; how far up and down
# a candidate may be moved, mm; error of the picture
_DRIFT, _REACH, _ERROR, _LENGTH = (row * _GROUP for row in (_POINTS, _POINTS + 4, _POINTS + 5, _POINTS + 6))
# where rows of the workspace begin, after those of where points meet what faces them, mm: where corners do; by how much
# the derivative jumps at a point; twice the cost of a squared step down from a corner; the derivative at height 0 of
# what is smooth; bounds of the best height, mm
_CORNER, _JUMP, _FALL, _LINE, _LOW, _HIGH, _ROOM = (
    row * _GROUP for row in (_POINTS, _POINTS + 4, _POINTS + 8, _POINTS + 12, _POINTS + 13, _POINTS + 14, _POINTS + 15)
)
# rows of what faces a facet, for 4 edges or corners each: whether there is anything; drifts toward the facet, of
# corners their products; costs of lost width, of a squared step, and twice that of lost area
_WITHIN, _WITHIN_DIAGONALLY, _INWARD, _DIAGONAL, _WIDTH, _EVEN, _AREA = range(7)

_ZERO, _HALF, _TWO = np.float32(0), np.float32(0.5), np.float32(2)


@njit(cache=True, nogil=True)
def _tabulate_part(part, errors, profiles, drifts, relief, table):
    """Part of the rows of facets, see ``tabulate``."""
    _, n, labels = errors.shape
    for i in range(part.first, part.end):
        for j in range(n):
            for k in range(labels):
                lanes, m, tallest = table[i, j, k // _GROUP], k % _GROUP, 0.0
                for e in range(4):
                    lanes[_DRIFT + e * _GROUP + m] = drifts[i, j, k, e, 0]
                    for q in range(EDGE_POINTS):
                        lanes[(EDGE_POINTS * e + q) * _GROUP + m] = profiles[i, j, k, e, q]
                        tallest = max(tallest, abs(profiles[i, j, k, e, q]))
                if tallest <= relief:
                    lanes[_REACH + m], lanes[_ERROR + m] = relief - tallest, errors[i, j, k]


def tabulate(errors: FloatArray, edges: Edges, relief: float) -> FloatArray:
    """What sweeps need to know of candidates, in the order in which they need it.

    Args:
        errors: (N, N, K) image errors; inf where there is no candidate.
        edges: the candidates' ``Edges`` (N, N, K, 4, Q), Q = ``EDGE_POINTS``, whose drifts are equal along an edge.
        relief: candidates that rise or fall more than this, mm, are left out.

    Returns:
        (N, N, groups, L) float32, L being the length of all rows of a group one after the other.
    """
    n, _, labels = errors.shape
    table = np.zeros((n, n, -(-labels // _GROUP), _LENGTH), np.float32)
    table[..., _ERROR : _ERROR + _GROUP] = np.inf
    in_threads(_tabulate_part, n, errors, edges.profiles, edges.drifts, relief, table)
    return table


@njit(cache=True, nogil=True)
def _chosen_part(part, choice, table, profiles, drifts):
    """Part of the rows of facets, see ``chosen_edges``."""
    for i in range(part.first, part.end):
        for j in range(choice.shape[1]):
            group, m = divmod(choice[i, j], _GROUP)
            for e in range(4):
                for q in range(EDGE_POINTS):
                    profiles[i, j, e, q] = table[i, j, group, (EDGE_POINTS * e + q) * _GROUP + m]
                    drifts[i, j, e, q] = table[i, j, group, _DRIFT + e * _GROUP + m]


def chosen_edges(choice: IntArray, table: FloatArray) -> Edges:
    """The ``Edges`` (N, N, 4, Q) float32 of the candidates (N, N) that facets take, from a table of all."""
    shape = *choice.shape, 4, EDGE_POINTS
    edges = Edges(np.empty(shape, np.float32), np.empty(shape, np.float32))
    in_threads(_chosen_part, len(choice), choice, table, edges.profiles, edges.drifts)
    return edges


@njit(cache=True)
def _ends(e):
    """Where the corner between edge e and the next is: where the rows of its two points begin."""
    p, q = EDGE_POINTS - 1 if e in (RIGHT, DOWN) else 0, EDGE_POINTS - 1 if e in (RIGHT, UP) else 0
    return (EDGE_POINTS * e + p) * _GROUP, (EDGE_POINTS * ((e + 1) % 4) + q) * _GROUP


@njit(cache=True)
def _put(lanes, m, height, outside):
    """Note how a facet's edges are that takes a candidate of a group at a height; outside: (4, Q + 1, 2).

    Heights of its points and, last in each row, corners; drifts, of corners their products.
    """
    for e in range(4):
        drift, following = lanes[_DRIFT + e * _GROUP + m], lanes[_DRIFT + (e + 1) % 4 * _GROUP + m]
        for q in range(EDGE_POINTS):
            outside[e, q, 0], outside[e, q, 1] = lanes[(EDGE_POINTS * e + q) * _GROUP + m] + height, drift
        here, there = _ends(e)
        outside[e, EDGE_POINTS, 0] = _HALF * (lanes[here + m] + lanes[there + m]) + height
        outside[e, EDGE_POINTS, 1] = drift * following


@njit(cache=True, nogil=True)
def _put_part(part, choice, heights, table, outsides):
    """Part of the rows of facets: what ``_put`` notes of each."""
    for i in range(part.first, part.end):
        for j in range(choice.shape[1]):
            group, m = divmod(choice[i, j], _GROUP)
            _put(table[i, j, group], m, np.float32(heights[i, j]), outsides[i, j])


@njit(cache=True)
def _face(i, j, outsides, terms, around, facing):
    """Fill in what faces facet (i, j).

    Args:
        i, j: row and column of the facet.
        outsides: (N, N, 4, Q + 1, 2), see ``_put``.
        terms: what steps cost.
        around: (4, Q + 1) to fill with heights, mm.
        facing: (7, 4) to fill with what steps down from and to it cost.
    """
    n = len(outsides)
    around[:], facing[:] = _ZERO, _ZERO
    for e in range(4):
        r, c, opposite = i + DOWNWARD[e], j + RIGHTWARD[e], (e + 2) % 4
        if 0 <= r < n and 0 <= c < n:
            for q in range(EDGE_POINTS):
                around[e, q] = outsides[r, c, opposite, q, 0]
            facing[_WITHIN, e] = 1.0
            facing[_INWARD, e] = outsides[r, c, opposite, 0, 1]
            facing[_WIDTH, e] = terms.loss / terms.pitch / EDGE_POINTS
            facing[_EVEN, e] = terms.even / EDGE_POINTS
        r, c = r + DOWNWARD[(e + 1) % 4], c + RIGHTWARD[(e + 1) % 4]
        if 0 <= r < n and 0 <= c < n:
            around[e, EDGE_POINTS] = outsides[r, c, opposite, EDGE_POINTS, 0]
            facing[_WITHIN_DIAGONALLY, e] = 1.0
            facing[_DIAGONAL, e] = outsides[r, c, opposite, EDGE_POINTS, 1]
            facing[_AREA, e] = 2.0 * terms.loss / terms.pitch**2


@njit(cache=True, fastmath=_FEWER_OPERATIONS)
def _meet(lanes, around, facing, space):
    """Fill in where a group's candidates meet what faces them, what that costs, and bounds of the best heights."""
    still = _ZERO
    for e in range(4):
        still -= np.float32(EDGE_POINTS) * facing[_WIDTH, e] * facing[_INWARD, e]
    for m in range(_GROUP):
        low, high, line = _ZERO, _ZERO, still
        for e in range(4):
            steps, within = _ZERO, facing[_WITHIN, e]
            for q in range(EDGE_POINTS):
                p = (EDGE_POINTS * e + q) * _GROUP + m
                height = within * (around[e, q] - lanes[p])
                space[p] = height
                low, high = min(low, height), max(high, height)
                steps += height
            line -= _TWO * facing[_EVEN, e] * steps
            drift, following = lanes[_DRIFT + e * _GROUP + m], lanes[_DRIFT + (e + 1) % 4 * _GROUP + m]
            space[_JUMP + e * _GROUP + m] = facing[_WIDTH, e] * (drift + facing[_INWARD, e])
            space[_FALL + e * _GROUP + m] = facing[_AREA, e] * drift * following
            here, there = _ends(e)
            corner = _HALF * (lanes[here + m] + lanes[there + m])
            height = facing[_WITHIN_DIAGONALLY, e] * (around[e, EDGE_POINTS] - corner)
            space[_CORNER + e * _GROUP + m] = height
            low, high = min(low, height), max(high, height)
        # above the highest meeting, or below the lowest, everything only grows; so it does away from height 0
        reach = lanes[_REACH + m]
        space[_LOW + m], space[_HIGH + m] = max(low, -reach), min(high, reach)
        space[_LINE + m] = line


@njit(cache=True, fastmath=_FEWER_OPERATIONS)
def _bisect(facing, screening, space):
    """Narrow the bounds of the best heights of a group's candidates."""
    bend = _TWO * screening
    for e in range(4):
        bend += _TWO * np.float32(EDGE_POINTS) * facing[_EVEN, e]
    for _ in range(_BISECTIONS):
        for m in range(_GROUP):
            height = _HALF * (space[_LOW + m] + space[_HIGH + m])
            slope = space[_LINE + m] + bend * height
            for e in range(4):
                jump, part = space[_JUMP + e * _GROUP + m], _ZERO
                for q in range(EDGE_POINTS):
                    part += jump if height > space[(EDGE_POINTS * e + q) * _GROUP + m] else _ZERO
                step, climb = height - space[_CORNER + e * _GROUP + m], facing[_AREA, e] * facing[_DIAGONAL, e]
                slope += part + step * (space[_FALL + e * _GROUP + m] if step > _ZERO else climb)
            above = slope > _ZERO
            space[_LOW + m] = space[_LOW + m] if above else height
            space[_HIGH + m] = height if above else space[_HIGH + m]


@njit(cache=True, fastmath=_FEWER_OPERATIONS)
def _weigh(facing, screening, space, energy, level):
    """Fill in a group's best heights, level (_GROUP,), and what candidates cost there but for the picture's errors."""
    for m in range(_GROUP):
        height = _HALF * (space[_LOW + m] + space[_HIGH + m])
        cost = screening * height * height
        for e in range(4):
            jump, still = space[_JUMP + e * _GROUP + m], facing[_WIDTH, e] * facing[_INWARD, e]
            for q in range(EDGE_POINTS):
                step = height - space[(EDGE_POINTS * e + q) * _GROUP + m]
                cost += jump * max(step, _ZERO) - still * step + facing[_EVEN, e] * step * step
            step, climb = height - space[_CORNER + e * _GROUP + m], facing[_AREA, e] * facing[_DIAGONAL, e]
            cost += _HALF * step * step * (space[_FALL + e * _GROUP + m] if step > _ZERO else climb)
        energy[m], level[m] = cost, height


@njit(cache=True)
def _draw(energy, temperature, die):
    """A candidate by the heat bath, ``P(k) ~ exp(-energy[k] / temperature)``; die in [0, 1). Energies are lost."""
    best = np.argmin(energy)
    if temperature <= 0.0:
        return best
    least, total = energy[best], 0.0
    for k in range(len(energy)):
        # what is far above the best would not be drawn
        far = energy[k] - least > 20.0 * temperature
        energy[k] = 0.0 if far else np.exp((least - energy[k]) / temperature)
        total += energy[k]
    left = die * total
    for k in range(len(energy)):
        left -= energy[k]
        if left < 0.0 and energy[k] > 0.0:
            return k
    return best


@njit(cache=True, nogil=True)
def _sweep_part(part, colour, state, table, terms, chance):
    """Part of the rows of a colour, see ``heat_bath_sweep``; state: choice, heights and what ``_put`` notes of them.

    chance: temperature and dice.
    """
    (choice, heights, outsides), (temperature, dice) = state, chance
    n, _, groups = table.shape[:3]
    around, facing = np.zeros((4, EDGE_POINTS + 1), np.float32), np.zeros((7, 4), np.float32)
    space, screening = np.zeros(_ROOM, np.float32), np.float32(terms.screening)
    energies, levels = np.zeros((2, groups * _GROUP), np.float32)
    for row in range(part.first, part.end):
        i = 2 * row + colour // 2
        for j in range(colour % 2, n, 2):
            _face(i, j, outsides, terms, around, facing)
            for group in range(groups):
                lanes, first = table[i, j, group], group * _GROUP
                energy, level = energies[first : first + _GROUP], levels[first : first + _GROUP]
                _meet(lanes, around, facing, space)
                _bisect(facing, screening, space)
                _weigh(facing, screening, space, energy, level)
                energy += lanes[_ERROR : _ERROR + _GROUP]
            k = _draw(energies, temperature, dice[i, j])
            choice[i, j], heights[i, j] = k, levels[k]
            _put(table[i, j, k // _GROUP], k % _GROUP, levels[k], outsides[i, j])


def heat_bath_sweep(
    choice: IntArray, heights: FloatArray, table: FloatArray, terms: EnergyTerms, temperature: float, dice: FloatArray
) -> None:  # fmt: skip
    """One heat-bath sweep over all facets, no neighbours at once: each draws a candidate, and takes its best height.

    ``P(k) ~ exp(-E_k / temperature)`` with the candidate's image error plus its energy at its best height, see
    ``optics.walls.best_height``; temperature 0 takes the best.

    Args:
        choice: (N, N) int64, updated in place.
        heights: (N, N) mm, updated in place.
        table: the candidates, see ``tabulate``.
        terms: what steps cost.
        temperature: same unit as the errors.
        dice: (N, N) random numbers in [0, 1).
    """
    n = len(choice)
    outsides = np.empty((n, n, 4, EDGE_POINTS + 1, 2), np.float32)
    in_threads(_put_part, n, choice, heights, table, outsides)
    state, chance = (choice, heights, outsides), (temperature, dice)
    for colour in range(4):
        in_threads(_sweep_part, (n + 1 - colour // 2) // 2, colour, state, table, terms, chance)
