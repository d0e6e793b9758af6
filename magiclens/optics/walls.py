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


_DIVISIONS, _TRIED = 5, 8
"""Divisions of the range between the lowest and the highest rise at which some point meets what faces it, and the rises
that are tried in each, side by side: to 2e-5 of that range."""


_GOLDEN = 0.618
"""Multiples of it, less their whole parts, are spread evenly."""


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


class _Meetings(NamedTuple):
    """Where points and corners of facets meet what faces them as the facets rise together, and what they cost then.

    Args:
        points, corners: (3, M) rises at which they meet it, mm; derivatives of the energy by the rise above and below
            that, of corners by half its square.
        counts: (2,) how many points and corners there are.
        smooth: (2,) derivative of all else at no rise, and per mm.
        bounds: (2,) between which the best rise is if nothing holds the facets, mm.
        slopes: (_TRIED,) derivatives at the rises that are tried.
    """

    points: FloatArray
    corners: FloatArray
    counts: IntArray
    smooth: FloatArray
    bounds: FloatArray
    slopes: FloatArray


@njit(cache=True)
def _room(points, facets):
    """Room for what as many facets meet."""
    return _Meetings(
        np.zeros((3, 4 * points * facets)), np.zeros((3, 4 * facets)),
        np.zeros(2, np.int64), np.zeros(2), np.zeros(2), np.zeros(_TRIED),
    )  # fmt: skip


@njit(cache=True)
def _add_meetings(own, around, height, terms, meetings):
    """Add what a facet meets from a height on; see ``best_height``."""
    counts, smooth, bounds = meetings.counts, meetings.smooth, meetings.bounds
    points = own.profiles.shape[1]
    width, area, even = terms.loss / terms.pitch / points, terms.loss / terms.pitch**2, 2.0 * terms.even / points
    smooth[0] += 2.0 * terms.screening * height
    smooth[1] += 2.0 * terms.screening
    bounds[0], bounds[1] = min(bounds[0], -height), max(bounds[1], -height)
    for e in range(4):
        if not np.isnan(around[e, 0, 0]):
            for q in range(points):
                rise, p = around[e, q, 0] - own.profiles[e, q] - height, counts[0]
                meetings.points[0, p] = rise
                meetings.points[1, p], meetings.points[2, p] = width * own.drifts[e, q], -width * around[e, q, 1]
                smooth[0] -= even * rise
                bounds[0], bounds[1] = min(bounds[0], rise), max(bounds[1], rise)
                counts[0] += 1
            smooth[1] += even * points
        if not np.isnan(around[e, points, 0]):
            corner, drift = _corner(own.profiles, own.drifts, e)
            rise, p = around[e, points, 0] - corner - height, counts[1]
            meetings.corners[0, p] = rise
            meetings.corners[1, p], meetings.corners[2, p] = 2.0 * area * drift, 2.0 * area * around[e, points, 1]
            bounds[0], bounds[1] = min(bounds[0], rise), max(bounds[1], rise)
            counts[1] += 1


@njit(cache=True)
def _try_rises(low, step, meetings):
    """Fill in the derivatives of the energy at ``low + step``, ``low + 2 step``, ..."""
    slopes = meetings.slopes
    for m in range(_TRIED):
        slopes[m] = meetings.smooth[0] + meetings.smooth[1] * (low + (m + 1.0) * step)
    for p in range(meetings.counts[0]):
        rise, above, below = meetings.points[0, p], meetings.points[1, p], meetings.points[2, p]
        for m in range(_TRIED):
            slopes[m] += above if low + (m + 1.0) * step > rise else below
    for p in range(meetings.counts[1]):
        rise, above, below = meetings.corners[0, p], meetings.corners[1, p], meetings.corners[2, p]
        for m in range(_TRIED):
            past = low + (m + 1.0) * step - rise
            slopes[m] += (above if past > 0.0 else below) * past


@njit(cache=True)
def _best_rise(meetings, low, high):
    """The rise at which facets cost least, between bounds."""
    # above the highest meeting, or below the lowest, everything only grows; so it does away from the reference plane
    a, b = min(max(meetings.bounds[0], low), high), max(min(meetings.bounds[1], high), low)
    for _ in range(_DIVISIONS):
        step = (b - a) / (_TRIED + 1)
        _try_rises(a, step, meetings)
        falling = 0
        while falling < _TRIED and meetings.slopes[falling] <= 0.0:
            falling += 1
        a, b = a + falling * step, a + (falling + 1) * step
    return 0.5 * (a + b)


@njit(cache=True)
def best_height(own, around, terms, low, high):
    """The height at which a facet costs least, and that cost.

    ``E(c) = sum over edges of mean over points of (loss * lost width / pitch + even * step^2) + sum over corners of
    loss * lost area / pitch^2 + screening * c^2``, the steps being ``own + c - around``. It is convex, so the
    sign of its derivative says on which side the best height is.

    Args:
        own: the facet's ``Edges`` (4, Q).
        around: (4, Q + 1, 2), see ``surroundings``.
        terms: what steps cost.
        low, high: bounds of the height, mm.
    """
    points = own.profiles.shape[1]
    meetings = _room(points, 1)
    _add_meetings(own, around, 0.0, terms, meetings)
    c = _best_rise(meetings, low, high)
    even, cost = terms.even / points, terms.screening * c * c
    for p in range(meetings.counts[0]):
        step = c - meetings.points[0, p]
        cost += meetings.points[1 if step > 0.0 else 2, p] * step + even * step * step
    for p in range(meetings.counts[1]):
        step = c - meetings.corners[0, p]
        cost += 0.5 * meetings.corners[1 if step > 0.0 else 2, p] * step * step
    return c, cost


@njit(cache=True)
def surroundings(i, j, heights, edges, around):
    """What faces facet (i, j) across its edges' points and, last in each row, its corners.

    Args:
        i, j: row and column of the facet.
        heights: (N, N) the facets' heights, mm.
        edges: the facets' ``Edges`` (N, N, 4, Q).
        around: (4, Q + 1, 2) to fill with heights, nan outside the lens, and drifts toward the facet.
    """
    n, points = len(heights), edges.profiles.shape[3]
    around[:] = np.nan
    for e in range(4):
        r, c, facing = i + DOWNWARD[e], j + RIGHTWARD[e], (e + 2) % 4
        if 0 <= r < n and 0 <= c < n:
            for q in range(points):
                around[e, q, 0] = edges.profiles[r, c, facing, q] + heights[r, c]
                around[e, q, 1] = edges.drifts[r, c, facing, q]
        r, c = r + DOWNWARD[(e + 1) % 4], c + RIGHTWARD[(e + 1) % 4]
        if 0 <= r < n and 0 <= c < n:
            height, drift = _corner(edges.profiles[r, c], edges.drifts[r, c], facing)
            around[e, points, 0], around[e, points, 1] = height + heights[r, c], drift


@njit(cache=True)
def _add_square(rows, columns, state, edges, terms, around, meetings):
    """Add what the facets of a square meet outside of it; returns how far they are from rising too little or much."""
    (i0, i1), (j0, j1), (heights, reach) = rows, columns, state
    low, high = -np.inf, np.inf
    for i in range(i0, i1):
        for j in range(j0, j1):
            low, high = max(low, -reach[i, j] - heights[i, j]), min(high, reach[i, j] - heights[i, j])
            if i0 < i < i1 - 1 and j0 < j < j1 - 1:
                around[:] = np.nan
            else:
                surroundings(i, j, heights, edges, around)
                for e in range(4):
                    f = (e + 1) % 4
                    r, c = i + DOWNWARD[e], j + RIGHTWARD[e]
                    if i0 <= r < i1 and j0 <= c < j1:
                        around[e, :-1] = np.nan
                    r, c = r + DOWNWARD[f], c + RIGHTWARD[f]
                    if i0 <= r < i1 and j0 <= c < j1:
                        around[e, -1] = np.nan
            own = Edges(edges.profiles[i, j], edges.drifts[i, j])
            _add_meetings(own, around, heights[i, j], terms, meetings)
    return low, high


@njit(cache=True, nogil=True)
def _levels_part(part, colour, squares, state, edges, terms):
    """Part of the rows of squares of a colour, see ``levels_sweep``.

    squares: side, and what is cut off the first. state: heights, and how far they may be from 0, (N, N).
    """
    (side, cut_rows, cut_columns), heights = squares, state[0]
    n, points = len(heights), edges.profiles.shape[3]
    around, meetings = np.zeros((4, points + 1, 2)), _room(points, 4 * side)  # facets inside meet nothing
    for row in range(part.first, part.end):
        block = 2 * row + colour // 2
        rows = max(block * side - cut_rows, 0), min((block + 1) * side - cut_rows, n)
        for left in range(colour % 2 * side - cut_columns, n, 2 * side):
            columns = max(left, 0), min(left + side, n)
            meetings.counts[:], meetings.smooth[:], meetings.bounds[:] = 0, 0.0, 0.0
            low, high = _add_square(rows, columns, state, edges, terms, around, meetings)
            if low <= high:
                rise = _best_rise(meetings, low, high)
                for i in range(rows[0], rows[1]):
                    for j in range(columns[0], columns[1]):
                        heights[i, j] += rise


def levels_sweep(
    heights: FloatArray, edges: Edges, terms: EnergyTerms, relief: float, squares: tuple[int, int, int]
) -> None:  # fmt: skip
    """Raise or lower squares of facets, no neighbours at once, to where they cost least: a descent on a convex energy.

    Args:
        heights: (N, N) mm, updated in place.
        edges: the facets' ``Edges`` (N, N, 4, Q).
        terms: what steps cost.
        relief: squares with facets that rise or fall more than this, mm, stay where they are.
        squares: their side, facets, and how many rows and columns are missing of the first.
    """
    _sweep(heights, edges, terms, _reach(edges, relief), squares)


def _reach(edges: Edges, relief: float) -> FloatArray:
    """(N, N) how far facets may be from the reference plane, mm."""
    reach: FloatArray = relief - np.abs(edges.profiles).max(axis=(2, 3))
    return reach


def _sweep(
    heights: FloatArray, edges: Edges, terms: EnergyTerms, reach: FloatArray, squares: tuple[int, int, int]
) -> None:
    """See ``levels_sweep``."""
    n, (side, cut_rows, _) = len(heights), squares
    blocks = -(-(n + cut_rows) // side)
    for colour in range(4):
        rows = (blocks + 1 - colour // 2) // 2
        in_threads(_levels_part, rows, colour, squares, (heights, reach), edges, terms)


def settle_levels(heights: FloatArray, edges: Edges, terms: EnergyTerms, relief: float, turn: int) -> None:
    """Sweep over squares of all sizes, from half the lens to single facets; ten turns leave little to gain.

    Single facets alone would soon be stuck, each held by neighbours that would have to move with it.

    Args:
        heights: (N, N) mm, updated in place.
        edges: the facets' ``Edges`` (N, N, 4, Q).
        terms: what steps cost.
        relief: see ``levels_sweep``.
        turn: how often this has been done; squares have other places each time.
    """
    side, reach = max(len(heights) // 2, 1), _reach(edges, relief)
    while side > 0:
        cut = int(_GOLDEN * turn % 1.0 * side)
        _sweep(heights, edges, terms, reach, (side, cut, cut))
        side //= 2


@njit(cache=True, nogil=True)
def _walls_part(part, heights, edges, terms, energies):
    """Part of the rows, see ``wall_energies``; energies: (N, N, 2) zeros, to add to."""
    loss, pitch, even, screening = terms
    n, points = len(heights), edges.profiles.shape[3]
    around = np.zeros((4, points + 1, 2))
    for i in range(part.first, part.end):
        for j in range(n):
            own = energies[i, j]
            surroundings(i, j, heights, edges, around)
            own[1] = screening * heights[i, j] ** 2
            for e in range(4):
                # both sides of every edge and corner are visited: count the own loss only, and half of the even part
                if not np.isnan(around[e, 0, 0]):
                    for q in range(points):
                        step = edges.profiles[i, j, e, q] + heights[i, j] - around[e, q, 0]
                        own[0] += loss / pitch * edges.drifts[i, j, e, q] * max(step, 0.0) / points
                        own[1] += 0.5 * even * step * step / points
                if not np.isnan(around[e, points, 0]):
                    height, drift = _corner(edges.profiles[i, j], edges.drifts[i, j], e)
                    step = height + heights[i, j] - around[e, points, 0]
                    own[0] += loss / pitch**2 * drift * max(step, 0.0) ** 2


def wall_energies(heights: FloatArray, edges: Edges, terms: EnergyTerms) -> FloatArray:
    """What each facet costs besides its error: light lost at its own walls, and the even part (step^2 and screening).

    The lost light is ``loss * (drift * step / pitch, mean over an edge's points, + drift^2 * step^2 / pitch^2 of
    corners)``, for steps > 0. Neighbours share what their edge costs for its step^2.

    Args:
        heights: (N, N) mm.
        edges: the facets' ``Edges`` (N, N, 4, Q).
        terms: what steps cost.

    Returns:
        (N, N, 2); the walls of the lens cost their sum.
    """
    energies = np.zeros((*heights.shape, 2))
    in_threads(_walls_part, len(heights), heights, edges, terms, energies)
    return energies
