"""The key size of universal lenses: how many other lenses there could have been (section 7)."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import BoolArray, IntArray


def key_size_bits(regions: IntArray, usable: BoolArray, rng: np.random.Generator, rounds: int = 64) -> float:
    """The key size: log2 of the number of ways to give every facet a sub-region of its own and one of its maps.

    Counting perfect matchings is hard, so they are estimated by sequential importance sampling: facets in random order
    draw among what is left, and the product of how much was left is right on average (Rasmussen, "Approximating the
    permanent", 1994). Rounds are few, so the estimate errs low.

    Args:
        regions: (F, D) number of each sub-region that a facet can show.
        usable: (F, D, S) with which of S maps it can.
        rng: draws the rounds.
        rounds: how many samples are averaged.

    Returns:
        Bits; -inf if every round gets stuck.
    """
    ways = usable.sum(axis=-1)
    logs = np.full(rounds, -np.inf)
    for k in range(rounds):
        taken = np.zeros(regions.max() + 1, bool)
        total = 0.0
        for facet in rng.permutation(len(regions)):
            left = ways[facet] * ~taken[regions[facet]]
            if not left.any():
                break
            total += np.log2(left.sum())
            taken[regions[facet, rng.choice(len(left), p=left / left.sum())]] = True
        else:
            logs[k] = total
    most = logs.max()
    return float(most + np.log2(np.exp2(logs - most).mean())) if np.isfinite(most) else -np.inf
