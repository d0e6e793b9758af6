"""Passes of messages between facets, from which a lower bound of the energy follows.

Candidates of a facet lie side by side, since loops over them are the inner ones. Edges are those of pairs: 0 between a
facet and the one to the right of it, 1 between a facet and the one below it. The step across is that from the second
up to the first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.optics.walls import DOWN, LEFT, RIGHT, UP

_FEWER_OPERATIONS = {"contract", "nsz", "reassoc"}
"""Sums may be in any order. Errors of candidates that are missing are infinite, so that infinity must be respected."""
_ZERO, _QUARTER, _HALF = np.float32(0), np.float32(0.25), np.float32(0.5)
_FAR = 12.0
"""Pairs that cost more than the best by so many temperatures count for nothing."""


class Choices(NamedTuple):
    """What facets choose from, single precision.

    Args:
        errors: (N, N, K) image errors; inf where there is no candidate.
        profiles: (N, N, 4, 4, K) heights of the edges' points, mm, see ``optics.walls.Edges``.
        drifts: (N, N, 4, K) outward drifts, equal along an edge.
    """

    errors: FloatArray
    profiles: FloatArray
    drifts: FloatArray


class Messages(NamedTuple):
    """What facets tell each other across the edges of pairs, (2, N, N, K) each.

    Args:
        onward: from the first of a pair to the second, and for each of its candidates.
        back: from the second to the first.
    """

    onward: FloatArray
    back: FloatArray


@njit(cache=True)
def _best_step(own, other, rise, fall, pull, terms):
    """The step, mm, at which a pair of candidates costs least, less its pull times the step; and where points meet.

    The derivative of the cost rises steadily, and by a jump wherever a point meets the one that faces it. So its zero
    is the highest, over the stretches in between, of the lower of the stretch's end and the zero of its straight line.

    Args:
        own, other: (4,) heights of points, mm.
        rise, fall: the candidates' outward drifts.
        pull: what a step brings in, per mm.
        terms: cost of lost width, and of a squared step.
    """
    width, even = terms
    a, b, c, d = other[0] - own[0], other[1] - own[1], other[2] - own[2], other[3] - own[3]
    low, up, down, high = min(a, b), max(a, b), min(c, d), max(c, d)
    first, third, second, last = min(low, down), min(up, high), max(low, down), max(up, high)
    second, third = min(second, third), max(second, third)
    flat = _HALF / even
    jump = width * _QUARTER * (rise + fall) * flat
    zero = _QUARTER * (a + b + c + d) + (pull + width * fall) * flat
    step = max(min(zero, first), min(zero - jump, second))
    step = max(max(step, min(zero - jump - jump, third)), min(zero - jump - jump - jump, last))
    return max(step, zero - np.float32(4) * jump), (a, b, c, d)


@njit(cache=True, fastmath=_FEWER_OPERATIONS)
def _tabulate(own, other, drifts, pull, terms, table):
    """Fill in what pairs of candidates of two facets cost, (K, K), each at its best step; see ``_best_step``.

    own, other: (4, K) heights of points. drifts: (K,) of both.
    """
    (width, even), (rises, falls) = terms, drifts
    for k in range(len(rises)):
        mine, rise = (own[0, k], own[1, k], own[2, k], own[3, k]), rises[k]
        for m in range(len(falls)):
            yours, fall = (other[0, m], other[1, m], other[2, m], other[3, m]), falls[m]
            step, (a, b, c, d) = _best_step(mine, yours, rise, fall, pull, terms)
            a, b, c, d = step - a, step - b, step - c, step - d
            above = max(a, _ZERO) + max(b, _ZERO) + max(c, _ZERO) + max(d, _ZERO)
            lost = width * (rise * above + fall * (above - (a + b + c + d)))
            table[k, m] = _QUARTER * (lost + even * (a * a + b * b + c * c + d * d)) - pull * step


@njit(cache=True, nogil=True)
def tabulate_part(part, choices, pulls, terms, tables):
    """Part of the rows of facets: what pairs of candidates cost at their best steps, less what steps bring in.

    Args:
        part: the rows.
        choices: what facets choose from.
        pulls: (2, N, N) float32, what a step brings in, per mm, across the edges of pairs.
        terms: float32, cost of lost width (per drift and mm) and of a squared step (per mm^2).
        tables: (2, N, N, K, K) float32 to fill.
    """
    (rows, columns, _), profiles, drifts = choices.errors.shape, choices.profiles, choices.drifts
    for i in range(part.first, part.end):
        for j in range(columns):
            if j + 1 < columns:
                faces = drifts[i, j, RIGHT], drifts[i, j + 1, LEFT]
                own, other = profiles[i, j, RIGHT], profiles[i, j + 1, LEFT]
                _tabulate(own, other, faces, pulls[0, i, j], terms, tables[0, i, j])
            if i + 1 < rows:
                faces = drifts[i, j, DOWN], drifts[i + 1, j, UP]
                own, other = profiles[i, j, DOWN], profiles[i + 1, j, UP]
                _tabulate(own, other, faces, pulls[1, i, j], terms, tables[1, i, j])


@njit(cache=True)
def _hear(i, j, errors, messages, heard):
    """Fill in (K,) errors of a facet's candidates plus what all around say; returns the share that chains have in it.

    A chain of facets passes through for every pair of edges, one from an earlier facet, one to a later.
    """
    (rows, columns, _), (onward, back) = errors.shape, messages
    heard[:] = errors[i, j]
    earlier = later = 0
    if j + 1 < columns:
        heard += back[0, i, j]
        later += 1
    if i + 1 < rows:
        heard += back[1, i, j]
        later += 1
    if j > 0:
        heard += onward[0, i, j - 1]
        earlier += 1
    if i > 0:
        heard += onward[1, i - 1, j]
        earlier += 1
    return np.float32(1.0 / max(earlier, later, 1))


@njit(cache=True, fastmath=_FEWER_OPERATIONS)
def _tell_onward(told, table, message):
    """Fill in a message (K,) to the second of a pair, whose least is 0; returns what is taken away for that."""
    message[:] = np.inf
    for k in range(len(told)):
        for m in range(len(message)):
            message[m] = min(message[m], told[k] + table[k, m])
    least = np.min(message)
    message -= least
    return least


@njit(cache=True, fastmath=_FEWER_OPERATIONS)
def _tell_back(told, table, message):
    """Fill in a message (K,) to the first of a pair, whose least is 0; returns what is taken away for that."""
    for k in range(len(message)):
        best = np.float32(np.inf)
        for m in range(len(told)):
            best = min(best, told[m] + table[k, m])
        message[k] = best
    least = np.min(message)
    message -= least
    return least


@njit(cache=True)
def pass_onward(errors, tables, messages):
    """Facets tell those to the right and below, row by row from the first.

    Args:
        errors: (N, N, K) image errors, float32; inf where there is no candidate.
        tables: (2, N, N, K, K) float32, what pairs cost.
        messages: updated in place.
    """
    rows, columns, labels = errors.shape
    heard, told = np.empty(labels, np.float32), np.empty(labels, np.float32)
    for i in range(rows):
        for j in range(columns):
            share = _hear(i, j, errors, messages, heard)
            for e in range(2):
                if (j + 1 < columns) if e == 0 else (i + 1 < rows):
                    for k in range(labels):
                        told[k] = share * heard[k] - messages.back[e, i, j, k]
                    _tell_onward(told, tables[e, i, j], messages.onward[e, i, j])


@njit(cache=True)
def pass_back(errors, tables, messages):
    """Facets tell those to the left and above, row by row from the last; returns a lower bound of the energy.

    That is the least energy of chains of facets that share the errors, which is never more than the least of the whole.

    Args:
        errors: (N, N, K) image errors, float32; inf where there is no candidate.
        tables: (2, N, N, K, K) float32, what pairs cost.
        messages: updated in place.
    """
    rows, columns, labels = errors.shape
    heard, told = np.empty(labels, np.float32), np.empty(labels, np.float32)
    bound = 0.0
    for i in range(rows - 1, -1, -1):
        for j in range(columns - 1, -1, -1):
            share = _hear(i, j, errors, messages, heard)
            least = np.min(heard)
            bound += least
            heard -= least
            for e in range(2):
                if (j if e == 0 else i) > 0:
                    row, column = i - e, j - (1 - e)
                    for k in range(labels):
                        told[k] = share * heard[k] - messages.onward[e, row, column, k]
                    bound += _tell_back(told, tables[e, row, column], messages.back[e, row, column])
    return bound


@njit(cache=True)
def _points(choices, edge, k):
    """(4,) heights of the points of a candidate's edge, mm, and its drift. edge: row, column and edge of the facet."""
    (i, j, e), p = edge, choices.profiles
    return (p[i, j, e, 0, k], p[i, j, e, 1, k], p[i, j, e, 2, k], p[i, j, e, 3, k]), choices.drifts[i, j, e, k]


@njit(cache=True)
def _mean_step(choices, own, other, told, table, pull, terms, temperature):
    """The mean step of one pair, see ``mean_steps_part``.

    own, other: rows, columns and edges of both facets. told: (K,) what is said of each one's candidates.
    """
    (mine, yours), labels = told, len(table)
    least = np.float32(np.inf)
    for k in range(labels):
        for m in range(labels):
            least = min(least, mine[k] + yours[m] + table[k, m])
    total = moment = 0.0
    for k in range(labels):
        for m in range(labels):
            above = (mine[k] + yours[m] + table[k, m] - least) / temperature
            if above < _FAR:
                points, rise = _points(choices, own, k)
                facing, fall = _points(choices, other, m)
                step, _ = _best_step(points, facing, rise, fall, pull, terms)
                weight = np.exp(-above)
                total += weight
                moment += weight * step
    return moment / total


@njit(cache=True, nogil=True)
def mean_steps_part(part, choices, pulls, terms, tables, messages, temperature, steps):
    """Part of the rows of facets: the mean of each pair's best steps, weighed by ``exp(-cost / temperature)``.

    Args:
        part: the rows.
        choices: what facets choose from.
        pulls: (2, N, N) float32, see ``tabulate_part``.
        terms: float32, see ``tabulate_part``.
        tables: (2, N, N, K, K) float32, what pairs cost besides what messages say.
        messages: of which a pair's own do not count.
        temperature: in the unit of energies.
        steps: (2, N, N) to fill, mm.
    """
    rows, columns, labels = choices.errors.shape
    first, second = np.empty(labels, np.float32), np.empty(labels, np.float32)
    for i in range(part.first, part.end):
        for j in range(columns):
            for e in range(2):
                r, c = i + e, j + 1 - e
                if r < rows and c < columns:
                    first *= _hear(i, j, choices.errors, messages, first)
                    second *= _hear(r, c, choices.errors, messages, second)
                    first -= messages.back[e, i, j]
                    second -= messages.onward[e, i, j]
                    own, other = (i, j, DOWN if e else RIGHT), (r, c, UP if e else LEFT)
                    told = first, second
                    steps[e, i, j] = _mean_step(
                        choices, own, other, told, tables[e, i, j], pulls[e, i, j], terms, temperature
                    )
