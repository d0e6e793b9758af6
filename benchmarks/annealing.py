"""Annealing: one candidate and one height per facet, by the ``heat-bath`` annealer, against a long plain annealing."""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.comparison import Comparison, require
from benchmarks.lenses import candidates, planned
from magiclens.annealing.heat_bath import HeatBath
from magiclens.contract.artifacts import Candidates


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """Against the same energy cooled many times as slowly: how much is left to gain, and at what price."""
    small = ("lens.facets=16", "lens.microfacets=8") if options.quick else ("lens.facets=32",)
    kept, sweeps = (8, 60) if options.quick else (32, 600)
    scene, found = planned("single", *small)[1], candidates("single", *small)
    found = Candidates(found.offsets_mm[:, :, :kept], found.maps[:, :, :kept], found.errors[:, :, :kept])

    def anneal(annealer: HeatBath) -> float:
        return annealer.anneal(scene, found, np.random.default_rng(0)).metrics["energy_after"]

    plain = HeatBath(sweeps=20 if options.quick else 60)
    task = f"{scene.lens.facets}² facets x {found.errors.shape[2]} candidates, {plain.sweeps} sweeps"
    peers = {f"{sweeps:,} sweeps": lambda: anneal(HeatBath(sweeps=sweeps))}
    return [Comparison("annealing", task, lambda: anneal(plain), peers, _energies_agree)]


def _energies_agree(ours: float, theirs: float) -> str:
    """The long annealing may be better, not much."""
    return require(ours < 1.1 * theirs, f"energy {100 * (ours / theirs - 1):+.1f} %")
