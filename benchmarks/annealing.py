"""Annealing: one candidate and one height per facet, by the ``heat-bath`` annealer, against a long plain annealing.

``heat-bath`` anneals as usual, and with squares of facets that settle in between. How much energy is left at the end is
also given above a bound that no choice of candidates can be below.
"""

from __future__ import annotations

import argparse
from functools import cache

import numpy as np

from benchmarks.comparison import Comparison, require
from benchmarks.lenses import candidates, planned
from magiclens.annealing.heat_bath import HeatBath
from magiclens.contract.artifacts import Candidates


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """Against the same energy cooled many times as slowly: how much is left to gain, and at what price."""
    if options.quick:
        settling = HeatBath(sweeps=20, settle=3, temperature=0.001)
        return [_compared("single", 16, 8, HeatBath(sweeps=20), 60), _compared("single", 8, 8, settling, 60)]
    large = ("single", "rotating") if options.thorough else ()
    return [
        _compared("single", 32, 32, HeatBath(), 600),
        *(_compared(spec, 128, 32, HeatBath(settle=3), 20_000) for spec in large),
    ]


def _compared(spec: str, facets: int, kept: int, annealer: HeatBath, sweeps: int) -> Comparison:
    """Against so many plain sweeps, which are done once if that takes long."""
    small = (f"lens.facets={facets}", *(("lens.microfacets=8",) if facets != 32 else ()))
    scene, found = planned(spec, *small)[1], candidates(spec, *small)
    found = Candidates(found.offsets_mm[:, :, :kept], found.maps[:, :, :kept], found.errors[:, :, :kept])

    def anneal(annealer: HeatBath, metric: str = "energy_after") -> float:
        return annealer.anneal(scene, found, np.random.default_rng(0)).metrics[metric]

    @cache
    def bound() -> float:
        return anneal(HeatBath(sweeps=1, bound=50), "energy_bound")

    def agreement(ours: float, theirs: float) -> str:
        """The long annealing may be better, not much."""
        above = " and ".join(f"{100 * (energy / bound() - 1):.1f}" for energy in (ours, theirs))
        return require(ours < 1.1 * theirs, f"energy {100 * (ours / theirs - 1):+.1f} %; {above} % above a bound")

    settled = f", settled after every {annealer.settle}, `{spec}`" if annealer.settle else ""
    task = f"{facets}² facets x {found.errors.shape[2]} candidates, {annealer.sweeps} sweeps{settled}"
    peers = {f"{sweeps:,} sweeps": lambda: anneal(HeatBath(sweeps=sweeps))}
    return Comparison("annealing", task, lambda: anneal(annealer), peers, agreement, once=facets > 32)
