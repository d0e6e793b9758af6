"""The energy of a choice of candidates and the swaps of the ``metropolis`` annealer, compiled (4.4, eqs 3 and 4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magiclens.kernels.compiler import njit


class Weights(NamedTuple):
    """Weights of the three terms of eq. (3): neighbours' differences, sideways turns and curl."""

    alpha: float
    beta: float
    gamma: float


@njit(cache=True)
def _facet_energy(normals, choice, i, j, k, weights):
    """``E = alpha sum_e |g_e - g|^2 / 16 + beta (across / 8)^2 + gamma (curl / 4)^2``, eq. (3), in 0..1.

    g is the normal's (x, y) of facet (i, j) with candidate k, g_e that of the neighbour across edge e; outside the
    lens, a facet's own normal goes on. ``across = d_y right + d_y left + d_x below + d_x above`` and
    ``curl = d_y right - d_y left - (d_x above - d_x below)``, all differences from g. The last term of E1 is printed
    d_y in the paper; by symmetry, and by its explanation, d_x is meant. Each term is divided by its largest value.

    Args:
        normals: (N, N, K, 2) x and y of unit normals, +y up.
        choice: (N, N) int64, the neighbours' candidates.
        i: row of the facet.
        j: column of the facet.
        k: the facet's own candidate, whatever ``choice`` says.
        weights: of the three terms.
    """
    n = len(choice)
    gx, gy = normals[i, j, k, 0], normals[i, j, k, 1]
    total = across = 0.0
    turn = np.zeros(4)
    for e in range(4):
        r = i - 1 if e == 2 else (i + 1 if e == 3 else i)
        c = j + 1 if e == 0 else (j - 1 if e == 1 else j)
        if 0 <= r < n and 0 <= c < n:
            dx = normals[r, c, choice[r, c], 0] - gx
            dy = normals[r, c, choice[r, c], 1] - gy
            total += dx * dx + dy * dy
            turn[e] = dy if e < 2 else dx
            across += turn[e]
    curl = (turn[0] - turn[1]) - (turn[2] - turn[3])
    return weights.alpha * total / 16.0 + weights.beta * (across / 8.0) ** 2 + weights.gamma * (curl / 4.0) ** 2


@njit(cache=True)
def lens_energy(normals, choice, weights):
    """Total lens energy: the sum of all facets' energies (4.4).

    Args:
        normals: (N, N, K, 2) x and y of unit normals, +y up.
        choice: (N, N) int64.
        weights: of the terms of eq. (3).
    """
    total = 0.0
    for i in range(len(choice)):
        for j in range(len(choice)):
            total += _facet_energy(normals, choice, i, j, choice[i, j], weights)
    return total


@njit(cache=True)
def try_swaps(normals, choice, usable, weights, threshold, facets, dice):
    """Swap candidates of facets one after the other, in place, where the facet's energy rises less than allowed.

    Args:
        normals: (N, N, K, 2) x and y of unit normals, +y up; each facet's usable candidates come first.
        choice: (N, N) int64, changed in place.
        usable: (N, N) how many candidates of a facet may be taken.
        weights: of the terms of eq. (3).
        threshold: a swap is made if it changes the facet's energy by less than this.
        facets: (T, 2) rows and columns of the facets that are tried.
        dice: (T,) in [0, 1), which of the usable candidates is tried.
    """
    for s in range(len(facets)):
        i, j = facets[s]
        k = int(dice[s] * usable[i, j])
        change = _facet_energy(normals, choice, i, j, k, weights) - _facet_energy(
            normals, choice, i, j, choice[i, j], weights
        )
        if change < threshold:
            choice[i, j] = k
