"""The cooling schedule of the heat-bath annealer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, Scene
from magiclens.contract.stages import Progress
from magiclens.geometry.facets import cost_of_lost_light, edge_models
from magiclens.optics.walls import sweep, total_energy

if TYPE_CHECKING:
    from magiclens.annealing.heat_bath import HeatBath


def anneal(
    options: HeatBath, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress
) -> Assignment:
    """See ``HeatBath.anneal``."""
    n = scene.lens.facets
    profiles, drifts = edge_models(scene, candidates.offsets_mm, candidates.maps)
    errors = candidates.errors.astype(np.float64)
    loss = options.loss_weight * cost_of_lost_light(scene)
    terms = (loss, scene.lens.pitch_mm, options.step_weight, options.screening)
    relief = scene.lens.relief_mm

    # the start: everyone's best candidate at its best height
    first, level = errors.argmin(axis=-1), np.zeros((n, n))
    fixed = np.where(np.arange(errors.shape[-1]) == first[..., None], errors, np.inf)
    for _ in range(options.sweeps):
        sweep(first, level, fixed, profiles, drifts, *terms, relief, 0.0, np.zeros((n, n)))
    before = float(total_energy(first, level, errors, profiles, drifts, *terms).sum())
    choice, heights = first.copy(), level.copy()
    fall = options.temperature * (1 - np.arange(options.sweeps) / options.sweeps) ** 2
    temperatures = np.concatenate([fall, np.zeros(10)])
    for done, temperature in enumerate(temperatures):
        sweep(choice, heights, errors, profiles, drifts, *terms, relief, temperature, rng.random((n, n)))
        progress((done + 1) / len(temperatures))
    after = float(total_energy(choice, heights, errors, profiles, drifts, *terms).sum())
    if after > before:
        choice, heights, after = first, level, before
    parts = total_energy(choice, heights, errors, profiles, drifts, *terms) / n**2
    return Assignment.pick(
        candidates,
        choice,
        {
            "energy_before": before / n**2, "energy_after": after / n**2,
            "energy_image": float(parts[0]), "energy_lost_light": float(parts[1]), "energy_even": float(parts[2]),
        },
    )
