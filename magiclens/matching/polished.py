"""Polishing for whoever searches in another way: rough candidates become as good as the exhaustive matcher's."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from magiclens.contract.artifacts import Candidates, Scene
from magiclens.matching.channels import stack_channels
from magiclens.matching.driver import Pool, finish, unreached
from magiclens.matching.exhaustive import Exhaustive
from magiclens.matching.search import reachable
from magiclens.optics.medium import image_optics_of


def polished(scene: Scene, rough: Candidates, options: Exhaustive | None = None) -> Candidates:
    """Candidates (N, N, K) moved, scaled and sheared until their patches' edges fall on the tile's, best first.

    What refraction cannot reach is left out. Errors are those that flat micro-facets will show, sampled pixel by pixel,
    the distance term included. options: window, step, pixels, polish, acceptance and candidates count as for the
    exhaustive matcher. Views must share an eye in the lens frame. Raises InputError naming a facet without candidates.
    """
    options = options or Exhaustive()
    lens, pool = scene.lens, Pool.of(rough)
    window, step = options.window.mm(lens.source_size_mm) / 2, options.step.mm(lens.source_size_mm)
    centres = lens.facet_centres_mm().reshape(-1, 2) * (1, -1)
    _drop_unreachable(centres, lens.pitch_mm / 2, image_optics_of(scene), pool.errors, pool.offsets, pool.maps)
    unreached(pool, lens)
    pool.sort()
    finish(pool, scene, stack_channels(scene), slice(0, lens.facets), options, window, step)
    return pool.candidates(lens, options.candidates)


@njit(cache=True, parallel=True)
def _drop_unreachable(centres, half, optics, errors, offsets, maps):
    """Set ``errors`` (F, K) to infinity where a facet cannot show its patch; image frame (y down)."""
    for f in prange(len(errors)):
        for k in range(errors.shape[1]):
            rx, ry, m = offsets[f, k, 0], offsets[f, k, 1], maps[f, k]
            if np.isfinite(errors[f, k]) and not reachable(
                (centres[f, 0], centres[f, 1]), (rx, ry), (m[0], m[1], m[2]), half, optics
            ):
                errors[f, k] = np.inf
