"""Prepares the pictures for the search, and runs it. Image frame: mm, x right, y down."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from magiclens import Candidates, FloatArray, InputError, Progress, Scene, central_slopes, resize, to_display
from mlens_patchmatch.search_kernels import PIXELS, World, guess, improve

BoolArray = NDArray[np.bool_]

if TYPE_CHECKING:
    from mlens_patchmatch.matcher import PatchMatch

_REACH_CELLS = 64
"""Cells per side of the window, in the table of what refraction can reach."""


def search(options: PatchMatch, scene: Scene, rng: np.random.Generator, progress: Progress) -> Candidates:
    """The best patch of each part of every facet's window, unpolished."""
    lens, parts = scene.lens, math.ceil(math.sqrt(options.candidates))
    n = lens.facets
    source, target = _stacked(scene)
    tiles = target.reshape(-1, n, PIXELS, n, PIXELS).transpose(1, 3, 2, 4, 0).reshape(n * n, PIXELS * PIXELS, -1)
    px, per_mm = lens.pitch_mm / PIXELS, len(source) / lens.source_size_mm
    grain = 1.4 * lens.pitch_mm / lens.microfacets
    finest = max(options.smallest * px, 1 / per_mm)
    widths = finest * 2.0 ** np.arange(max(math.ceil(math.log2(options.largest * px / finest)), 0) + 1)
    levels = np.stack([to_display(_averaged(source, (w + grain) * per_mm)) for w in widths]).astype(np.float32)
    window = options.window.mm(lens.source_size_mm) / 2
    centres = lens.facet_centres_mm().reshape(-1, 2) * (1, -1)
    order = rng.permutation(PIXELS * PIXELS)
    seeds = rng.integers(1, 2**63, n * n).astype(np.uint64)
    errors = np.full((n * n, parts * parts), np.inf, np.float32)
    patches = np.zeros((n * n, parts * parts, 4), np.float32)
    flat = np.ascontiguousarray(tiles, np.float32)
    world = World(
        flat, centres, _reach(scene, window), levels, widths, per_mm, px, window, order,
        math.log(options.smallest), math.log(options.largest),
    )  # fmt: skip
    guess(world, options.guesses, seeds, errors, patches)
    for done in range(options.rounds):
        improve(world, n, seeds, errors.copy(), patches.copy(), errors, patches)
        progress((done + 1) / (options.rounds + 1))
    k = (n, n, -1)
    maps = np.stack([patches[..., 2], np.zeros_like(errors), patches[..., 3]], axis=-1)
    offsets = patches[..., :2] * np.array([1, -1], np.float32)
    return Candidates(offsets.reshape(*k, 2), maps.reshape(*k, 3), errors.reshape(k))


def _stacked(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """The sources (H, H, C) in linear light and the targets (C, R, R) in display values, C = views x colours."""
    views = [view.in_lens_frame() for view in scene.views]
    if any(not np.allclose(view.eye_mm, views[0].eye_mm) for view in views):
        raise InputError("matcher patchmatch needs views that share one eye; 'multi-view' takes several")
    side, across = max(len(view.source) for view in views), scene.lens.facets * PIXELS
    source = np.concatenate([resize(view.source, (side, side)) for view in views], axis=-1)
    target = np.concatenate([to_display(resize(view.target, (across, across))) for view in views], axis=-1)
    return source, np.moveaxis(target, -1, 0)


def _reach(scene: Scene, window: float) -> BoolArray:
    """(F, cells, cells) bool: whether the middle of a facet can show what lies in a cell of its window; y down."""
    n, at = scene.lens.facets, ((np.arange(_REACH_CELLS) + 0.5) / _REACH_CELLS * 2 - 1) * window
    x, y = np.meshgrid(at, -at)
    offsets = np.broadcast_to(np.stack([x, y], axis=-1).reshape(-1, 2), (n, n, x.size, 2))
    slopes = np.linalg.norm(central_slopes(scene, np.ascontiguousarray(offsets)), axis=-1)
    within: BoolArray = slopes < np.tan(np.radians(scene.lens.max_slope_deg))
    return np.ascontiguousarray(within.reshape(n * n, *x.shape))


def _averaged(source: FloatArray, width_px: float) -> FloatArray:
    """The mean over boxes of an odd number of pixels, about so wide."""
    odd = 2 * round((width_px - 1) / 2) + 1
    if odd < 2:
        return source
    averaged: FloatArray = uniform_filter1d(uniform_filter1d(source, odd, axis=0), odd, axis=1)
    return averaged
