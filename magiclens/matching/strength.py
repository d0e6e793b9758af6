"""How many universal lenses there could have been: the size of the key that a lens is (section 7)."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import BoolArray, IntArray


def injective_maps_bits(places: IntArray, usable: BoolArray, rng: np.random.Generator, rounds: int = 64) -> float:
    """log2 of the number of ways to give every facet a place of its own and one of its mirror signs.

    places: (F, D) number of each place a facet can look at. usable: (F, D, S): with which signs. Counting perfect
    matchings is hard, so they are estimated by sequential importance sampling: facets in random order draw among what
    is left, and the product of how much was left is right on average (Rasmussen, "Approximating the permanent", 1994).
    Rounds are few, so the estimate errs low; -inf if every round gets stuck.
    """
    ways = usable.sum(axis=-1)
    logs = np.full(rounds, -np.inf)
    for k in range(rounds):
        taken = np.zeros(places.max() + 1, bool)
        total = 0.0
        for facet in rng.permutation(len(places)):
            left = ways[facet] * ~taken[places[facet]]
            if not left.any():
                break
            total += np.log2(left.sum())
            taken[places[facet, rng.choice(len(left), p=left / left.sum())]] = True
        else:
            logs[k] = total
    most = logs.max()
    return float(most + np.log2(np.exp2(logs - most).mean())) if np.isfinite(most) else -np.inf
