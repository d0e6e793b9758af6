"""How little energy annealing could leave at best: a bound below that of any choice of candidates and heights.

Neighbours agree on candidates by messages (TRW-S, Kolmogorov, "Convergent Tree-Reweighted Message Passing for Energy
Minimization", PAMI 28(10), 2006). Heights come in by the steps between neighbours, which add up to nothing around the
corner of four facets. A price is put on what they do add up to; then every pair may take its own best step, and as the
prices settle (a subgradient method), steps around each corner close on average. Facets that are screened resist, in the
same way, to be as high as the steps ask. Diagonal neighbours cost little, and nothing here.

The bound stays below what annealing finds for two reasons. Steps need not close for each choice of candidates, only on
average over those that neighbours have not yet decided between; and the best choice itself is not known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray

if TYPE_CHECKING:
    from magiclens.annealing.lower_bound_kernels import Choices, Messages
    from magiclens.optics.walls import Edges, EnergyTerms

_LEAST_EVEN = 1e-7
"""Cost of a squared step, per mm^2 and edge, below which best steps would be too far away."""
_WARM, _FAST = 0.4, 1.0
"""At the start: the temperature at which steps are averaged, in units of what an edge costs; how far prices move, in
units of that by what steps add up to."""
_COOLING = 12
"""Rounds after which both are half of that, and heights resist twice as much."""
_CAUTION = 4.0
"""How much heights that are asked for resist change at the start, in units of screening over the cost of steps."""
_INERTIA = 0.9
"""Share of the direction in which prices moved that is kept."""


def lower_bound(errors: FloatArray, edges: Edges, terms: EnergyTerms, relief: float, rounds: int) -> float:
    """A number below the energy of every choice of candidates and heights; the more rounds, the higher.

    Args:
        errors: (R, C, K) image errors; inf where there is no candidate.
        edges: the candidates' ``Edges`` (R, C, K, 4, 4), whose drifts are equal along an edge.
        terms: what steps cost.
        relief: no point of a facet rises or falls more than this, mm.
        rounds: of messages and prices. Each takes about as long as eight sweeps of annealing.

    Returns:
        The bound for the whole lens, in the unit of errors.
    """
    from magiclens.annealing.lower_bound_kernels import mean_steps_part, pass_back, pass_onward, tabulate_part
    from magiclens.kernels.threads import in_threads

    choices, messages, tables = _prepared(errors, edges)
    rows, columns = errors.shape[:2]
    even, pairs = max(terms.even, _LEAST_EVEN), rows * (columns - 1) + columns * (rows - 1)
    costs = np.float32(terms.loss / terms.pitch), np.float32(even)
    # by how much squared steps may cost more here than they do
    beyond = (even - terms.even) * pairs * (2 * relief) ** 2
    prices, speed = np.zeros((2, rows - 1, columns - 1))
    heights: FloatArray = np.zeros((rows, columns))
    steps = np.zeros((2, rows, columns))
    best, alone = -np.inf, float(choices.errors.min(axis=-1).sum(dtype=np.float64))
    for done in range(rounds):
        pulls = (_around_corners(prices) + _toward(heights, terms.screening)).astype(np.float32)
        in_threads(tabulate_part, rows, choices, pulls, costs, tables)
        pass_onward(choices.errors, tables, messages)
        bound = pass_back(choices.errors, tables, messages) + _least_of_heights(pulls, terms.screening, relief)
        best, cooled = max(best, bound), 1 / (1 + done / _COOLING)
        if done == 0:
            edge = max((bound - alone) / max(pairs, 1), 1e-12)
        in_threads(mean_steps_part, rows, choices, pulls, costs, tables, messages, _WARM * edge * cooled, steps)
        heights = _nearer(heights, steps, _CAUTION * terms.screening / even / cooled)
        around = _around(steps)
        if done == 0:
            reach = _FAST * edge / max(_rms(around), 1e-9)
        speed = _INERTIA * speed - (1 - _INERTIA) * around
        prices += reach * cooled * speed / max(_rms(speed), 1e-30)
    return max(float(best - beyond), alone)


def _prepared(errors: FloatArray, edges: Edges) -> tuple[Choices, Messages, FloatArray]:
    """Candidates for kernels, of every facet the finite ones first; messages that say nothing yet; room for tables."""
    from magiclens.annealing.lower_bound_kernels import Choices, Messages

    there = np.isfinite(errors)
    order = np.argsort(~there, axis=-1, kind="stable")[..., : there.sum(axis=-1).max()]
    drifts = np.take_along_axis(edges.drifts[..., 0], order[..., None], axis=2)
    profiles = np.take_along_axis(edges.profiles, order[..., None, None], axis=2)
    choices = Choices(
        np.take_along_axis(errors, order, axis=-1).astype(np.float32),
        np.ascontiguousarray(np.moveaxis(profiles, 2, -1), np.float32),
        np.ascontiguousarray(np.moveaxis(drifts, 2, -1), np.float32),
    )
    shape = 2, *order.shape
    messages = Messages(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
    return choices, messages, np.zeros((*shape, order.shape[-1]), np.float32)


def _around_corners(prices: FloatArray) -> FloatArray:
    """(2, R, C): what steps across edges bring in, per mm, by the prices (R - 1, C - 1) at inner corners."""
    pulls = np.zeros((2, prices.shape[0] + 1, prices.shape[1] + 1))
    pulls[0, :-1, :-1] += prices
    pulls[0, 1:, :-1] -= prices
    pulls[1, :-1, 1:] += prices
    pulls[1, :-1, :-1] -= prices
    return pulls


def _around(steps: FloatArray) -> FloatArray:
    """(R - 1, C - 1) what steps (2, R, C) across edges add up to around inner corners, mm."""
    right, down = steps
    around: FloatArray = right[:-1, :-1] + down[:-1, 1:] - right[1:, :-1] - down[:-1, :-1]
    return around


def _outward(steps: FloatArray) -> FloatArray:
    """(R, C) the sum of what (2, R, C) is across the edges of every facet, counted outward."""
    right, down = steps[0, :, :-1], steps[1, :-1]
    outward = np.zeros(steps.shape[1:])
    outward[:, :-1] += right
    outward[:, 1:] -= right
    outward[:-1] += down
    outward[1:] -= down
    return outward


def _modes(rows: int, columns: int) -> FloatArray:
    """(R, C) eigenvalues of the Laplacian of the grid of facets, by cosine; that of the mean is infinite: it is 0."""
    down, right = (2 - 2 * np.cos(np.pi * np.arange(count) / count) for count in (rows, columns))
    modes: FloatArray = down[:, None] + right
    modes[0, 0] = np.inf
    return modes


def _nearer(heights: FloatArray, steps: FloatArray, caution: float) -> FloatArray:
    """Heights (R, C) nearer to those whose steps are most like some (2, R, C)."""
    from scipy.fft import dctn, idctn

    spectrum = dctn(_outward(steps) + caution * heights, norm="ortho") / (_modes(*heights.shape) + caution)
    nearer: FloatArray = idctn(spectrum, norm="ortho")
    return nearer


def _toward(heights: FloatArray, screening: float) -> FloatArray:
    """(2, R, C) the pulls, per mm of step, under which facets are held at heights (R, C) by their screening."""
    from scipy.fft import dctn, idctn

    potential = idctn(-2 * screening * dctn(heights, norm="ortho") / _modes(*heights.shape), norm="ortho")
    pulls = np.zeros((2, *heights.shape))
    pulls[0, :, :-1] = potential[:, :-1] - potential[:, 1:]
    pulls[1, :-1] = potential[:-1] - potential[1:]
    return pulls


def _least_of_heights(pulls: FloatArray, screening: float, relief: float) -> float:
    """The least that facets cost by their heights, as the pulls (2, R, C) at their edges pay them for it."""
    outward = np.abs(_outward(pulls.astype(np.float64)))
    heights = np.minimum(relief, outward / (2 * max(screening, 1e-30)))
    return float((screening * heights**2 - outward * heights).sum())


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
