"""Runs the compiled kernels of the exhaustive matcher over all rasters."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import Candidates, FloatArray, Lens, Scene
from magiclens.contract.errors import InputError
from magiclens.contract.stages import Progress
from magiclens.matching import raster as rasters
from magiclens.matching.channels import Channels, stack_channels
from magiclens.matching.judge import judge
from magiclens.matching.polish import blur_levels, polish
from magiclens.matching.search import search
from magiclens.optics.medium import image_optics_of

if TYPE_CHECKING:
    from magiclens.matching.exhaustive import Exhaustive


GRAIN_MARGIN = 1.4
"""Patches must look right even when a micro-facet shows this many times its own size.

A pixel rarely sees whole micro-facets, so patches that are only just large enough sparkle. Measured on unseen glyphs at
22 micro-facets: 1.0 gives the best matching bound, 1.3 to 1.6 the best path-traced picture.
"""


class Pool:
    """The candidates under construction: flat facets, one bucket per candidate, image frame (y down)."""

    def __init__(self, facets: int, buckets: int):
        k = buckets * buckets
        self.buckets = buckets
        self.errors = np.full((facets, k), np.inf, np.float32)
        self.offsets = np.zeros((facets, k, 2), np.float64)
        self.maps = np.zeros((facets, k, 3), np.float64)

    @classmethod
    def of(cls, candidates: Candidates) -> Pool:
        """A pool of candidates that there are already."""
        n, _, k = candidates.errors.shape
        pool = cls(n * n, 0)
        pool.errors = candidates.errors.reshape(n * n, k).copy()
        pool.offsets = candidates.offsets_mm.reshape(n * n, k, 2).astype(np.float64) * (1, -1)
        pool.maps = candidates.maps.reshape(n * n, k, 3).astype(np.float64) * (1, -1, 1)
        return pool

    def restore(self, known: Pool) -> None:
        """Give facets that have no candidate left those of another pool of this size."""
        empty = ~np.isfinite(self.errors).any(axis=1)
        self.errors[empty], self.offsets[empty], self.maps[empty] = (
            known.errors[empty], known.offsets[empty], known.maps[empty]
        )  # fmt: skip

    def sort(self) -> None:
        """Best first."""
        order = np.argsort(self.errors, axis=1, kind="stable")
        self.errors = np.take_along_axis(self.errors, order, 1)
        self.offsets = np.take_along_axis(self.offsets, order[..., None], 1)
        self.maps = np.take_along_axis(self.maps, order[..., None], 1)

    def drop(self, acceptance: float) -> None:
        """Give up candidates whose error exceeds their facet's best by more than ``acceptance``."""
        self.errors[self.errors > self.errors.min(axis=1, keepdims=True) + acceptance] = np.inf

    def candidates(self, lens: Lens, most: int) -> Candidates:
        """The best ``most`` of every facet, +y up."""
        errors = self.errors[:, :most]
        shape = (-1, lens.facets, errors.shape[1])
        return Candidates(
            (self.offsets[:, :most] * (1, -1)).reshape(*shape, 2).astype(np.float32),
            (self.maps[:, :most] * (1, -1, 1)).reshape(*shape, 3).astype(np.float32),
            errors.reshape(shape),
        )


def flat_scale(scene: Scene) -> float:
    """How many mm of the source the eye sees per mm of a flat facet: a little over 1, by perspective."""
    lens = scene.lens
    far = float(scene.reference_eye_mm[2]) - lens.thickness_mm
    return 1 + (lens.thickness_mm / lens.ior + lens.gap_mm) / far


def seen_grain(scene: Scene) -> float:
    """Side of the source patch, mm, over which search and polishing average: a micro-facet's, with a margin."""
    return GRAIN_MARGIN * flat_scale(scene) * scene.lens.pitch_mm / scene.lens.microfacets


def match(options: Exhaustive, scene: Scene, rows: slice, progress: Progress) -> Candidates:
    """See ``Exhaustive.match_rows``."""
    lens, channels = scene.lens, stack_channels(scene)
    tiles = channels.tiles(lens.facets, options.pixels)[rows].reshape(-1, len(channels.target), *(options.pixels,) * 2)
    centres = lens.facet_centres_mm()[rows].reshape(-1, 2) * (1, -1)
    pool = Pool(len(tiles), math.ceil(math.sqrt(options.candidates)))
    window, step = options.window.mm(lens.source_size_mm) / 2, options.step.mm(lens.source_size_mm)
    search_all(options, scene, channels, tiles, centres, window, step, pool, progress)
    unreached(pool, lens, rows.start)
    pool.sort()
    finish(pool, scene, channels, rows, options, window, step)
    return pool.candidates(lens, options.candidates)


def finish(
    pool: Pool, scene: Scene, channels: Channels, rows: slice, options: Exhaustive, window: float, step: float
) -> None:
    """Polish, judge and sort what a search has left in the pool; ``window`` is half the search window's side."""
    lens, pixels = scene.lens, 2 * options.pixels
    tiles = channels.tiles(lens.facets, pixels)[rows].reshape(len(pool.errors), -1, pixels, pixels)
    centres = lens.facet_centres_mm()[rows].reshape(-1, 2) * (1, -1)
    grain = seen_grain(scene)
    widths = (0.0, 0.1, 0.2, 0.35)
    levels = blur_levels(channels.source, channels.source_px_mm, grain, widths)
    polish(
        _channels_last(tiles), _channels_last(levels), np.array(widths),
        1 / channels.source_px_mm, centres, lens.pitch_mm, window, step, options.polish, 10, options.maps == "scale",
        image_optics_of(scene), pool.errors, pool.offsets, pool.maps,
    )
    pool.drop(options.acceptance)
    judge(
        tiles, channels.source, 1 / channels.source_px_mm, centres, lens.pitch_mm, lens.microfacets, flat_scale(scene),
        window, step, rasters.DISPLAY, pool.errors, pool.offsets, pool.maps,
    )
    pool.drop(options.acceptance)
    pool.sort()


def _channels_last(images: FloatArray) -> FloatArray:
    return np.ascontiguousarray(np.moveaxis(images, -3, -1))


def unreached(pool: Pool, lens: Lens, first_row: int = 0) -> None:
    """Raise InputError naming the first facet without a candidate, if there is one."""
    empty = np.flatnonzero(~np.isfinite(pool.errors).any(axis=1))
    if len(empty):
        row, column = divmod(int(empty[0]) + first_row * lens.facets, lens.facets)
        raise InputError(
            f"facet (row {row}, column {column}) reaches no patch of the source: "
            "use a smaller window or scales, a thicker lens, a larger gap or max_slope, or a larger source"
        )


def search_all(
    options: Exhaustive, scene: Scene, channels: Channels, tiles: FloatArray, centres: FloatArray,
    window: float, step: float, pool: Pool, progress: Progress,
) -> None:
    """Search every raster; rasters that share their x axis share its footprint averages."""
    size, source = scene.lens.source_size_mm, channels.source
    px = scene.lens.pitch_mm / options.pixels
    grain = seen_grain(scene)
    per_side = options.pixels // rasters.BLOCK
    blocks = tiles.reshape(*tiles.shape[:2], per_side, rasters.BLOCK, per_side, rasters.BLOCK).mean(axis=(3, 5))
    symmetric = options.maps == "symmetric"
    scales = [s for s in resolved_scales(options.scales, px, channels.source_px_mm) if s * px < size]
    pairs = list(itertools.product(scales, repeat=2)) if symmetric else [(s, s) for s in scales]
    for done, (sx, group) in enumerate(itertools.groupby(pairs, key=lambda p: p[0])):
        x = rasters.axis(sx, px, step, size)
        columns = rasters.average_columns(source, *rasters.footprints(x, sx * px + grain, size, source.shape[2]))
        for _, sy in group:
            y = rasters.axis(sy, px, step, size)
            taps = rasters.footprints(y, sy * px + grain, size, source.shape[1])
            samples, means = rasters.build(columns, *taps, x, y)
            search(
                tiles, blocks, samples, means, sx, sy, x.spacing_mm, y.spacing_mm, x.count, y.count, x.skip, y.skip,
                centres, window, step, pool.buckets, symmetric, image_optics_of(scene),
                pool.errors, pool.offsets, pool.maps,
            )
        progress((done + 1) / len(scales))


def resolved_scales(scales: tuple[float, ...], px: float, source_px: float) -> tuple[float, ...]:
    """The scales without those so small that a tile pixel sees less than half a source pixel: these are raised."""
    return tuple(sorted({max(scale, 0.5 * source_px / px) for scale in scales}))
