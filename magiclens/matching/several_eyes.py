"""Runs the kernels of the multi-view matcher."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import Candidates, FloatArray, IntArray, Scene
from magiclens.contract.stages import Progress
from magiclens.images import resize, to_display
from magiclens.matching import joint
from magiclens.matching.driver import Pool, resolved_scales, seen_grain, unreached
from magiclens.matching.polish import blur_levels, box_blur
from magiclens.matching.raster import DISPLAY
from magiclens.optics.medium import image_optics_of

if TYPE_CHECKING:
    from magiclens.matching.multi_view import MultiView

WIDTHS_MM = (0.0, 0.1, 0.2, 0.35)


@dataclass(frozen=True)
class Eyes:
    """The views of a scene in the lens frame, y down.

    sources: (S, C, H, H) float32 linear light, each once. which: (V,) source of each view. positions_mm: (V, 3).
    targets: (V, C, T, T) float32 linear light.
    """

    sources: FloatArray
    which: IntArray
    positions_mm: FloatArray
    targets: FloatArray

    def rasters(self, side: int) -> FloatArray:
        """(V, C, side, side) float32: the targets in display values."""
        small = [np.moveaxis(resize(np.moveaxis(t, 0, -1), (side, side)), -1, 0) for t in self.targets]
        return np.ascontiguousarray(to_display(np.stack(small)), np.float32)


def eyes_of(scene: Scene) -> Eyes:
    """All views of a scene; pictures of different sizes are brought to the largest."""
    views = [view.in_lens_frame() for view in scene.views]
    keys = [(view.source_name, view.quarter_turns) for view in scene.views]
    names = list(dict.fromkeys(keys))
    side = max(len(view.source) for view in views)
    across = max(len(view.target) for view in views)
    sources = [resize(views[keys.index(name)].source, (side, side)) for name in names]
    targets = [resize(view.target, (across, across)) for view in views]
    return Eyes(
        np.ascontiguousarray(np.moveaxis(np.stack(sources), -1, 1)),
        np.array([names.index(key) for key in keys]),
        np.stack([view.eye_mm for view in views]) * (1, -1, 1),
        np.moveaxis(np.stack(targets), -1, 1),
    )


def match(options: MultiView, scene: Scene, heights: FloatArray, progress: Progress) -> Candidates:
    """See ``MultiView.match``; heights: (N, N) mm, where the facets' centres stand."""
    lens, eyes = scene.lens, eyes_of(scene)
    pool = Pool(lens.facets**2, math.ceil(math.sqrt(options.candidates)))
    window, step = options.window.mm(lens.source_size_mm) / 2, options.step.mm(lens.source_size_mm)
    source_px = lens.source_size_mm / eyes.sources.shape[2]
    block = lens.pitch_mm / joint.BLOCKS
    scales = resolved_scales(options.scales, block, source_px)
    symmetric = options.maps == "symmetric"
    pairs = list(itertools.product(scales, repeat=2)) if symmetric else [(s, s) for s in scales]
    grain = seen_grain(scene)
    targets = eyes.rasters(lens.facets * joint.BLOCKS)
    images = np.stack([averaged(eyes.sources, [(s * block + grain) / source_px for s in pair]) for pair in pairs])
    joint.search(
        targets, images, eyes.which, np.array(pairs), 1 / source_px, *_places(scene, heights), lens.pitch_mm,
        lens.size_mm, window, step, pool.buckets, symmetric, eyes.positions_mm, image_optics_of(scene), pool.errors,
        pool.offsets, pool.maps,
    )
    progress(0.7)
    unreached(pool, lens)
    pool.sort()
    return _finish(options, scene, eyes, pool, heights, progress)


def averaged(sources: FloatArray, box: Sequence[float]) -> FloatArray:
    """(S, C, H, W) float32 display values of sources averaged over boxes so many pixels wide and tall."""
    return to_display(np.stack([box_blur(s, box[1], box[0]) for s in sources])).astype(np.float32)


def rematch(
    options: MultiView, scene: Scene, candidates: Candidates, heights: FloatArray, progress: Progress
) -> Candidates:
    """See ``MultiView.rematch``. Facets that now see nothing but the source's rim keep the candidates they had."""
    return _finish(options, scene, eyes_of(scene), Pool.of(candidates), heights, progress, Pool.of(candidates))


def _finish(
    options: MultiView, scene: Scene, eyes: Eyes, pool: Pool, heights: FloatArray, progress: Progress,
    known: Pool | None = None,
) -> Candidates:  # fmt: skip
    """Polish and judge a pool of candidates; ``known`` is for facets that lose all of theirs."""
    lens = scene.lens
    window, step = options.window.mm(lens.source_size_mm) / 2, options.step.mm(lens.source_size_mm)
    per_mm = eyes.sources.shape[2] / lens.source_size_mm
    fine = eyes.rasters(2 * lens.facets * options.pixels)
    levels = np.stack([blur_levels(s, 1 / per_mm, seen_grain(scene), WIDTHS_MM) for s in eyes.sources], axis=1)
    places, optics = _places(scene, heights), image_optics_of(scene)
    joint.polish(
        fine, levels, np.array(WIDTHS_MM), eyes.which, per_mm, *places, lens.pitch_mm, lens.size_mm,
        2 * options.pixels, window, step, options.polish, 10, options.maps == "scale", eyes.positions_mm, optics,
        pool.errors, pool.offsets, pool.maps,
    )
    progress(0.85)
    pool.drop(options.acceptance)
    joint.judge(
        fine, eyes.sources, eyes.which, per_mm, *places, lens.pitch_mm, lens.size_mm, 2 * options.pixels,
        lens.microfacets, window, step, DISPLAY, eyes.positions_mm, optics,
        pool.errors, pool.offsets, pool.maps,
    )
    if known is not None:
        pool.restore(known)
    unreached(pool, lens)
    pool.drop(options.acceptance)
    pool.sort()
    return replace(pool.candidates(lens, options.candidates), heights_mm=heights)


def _places(scene: Scene, heights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(F, 2) facet centres, y down, and (F,) their heights."""
    return scene.lens.facet_centres_mm().reshape(-1, 2) * (1, -1), np.ascontiguousarray(heights, np.float64).ravel()
