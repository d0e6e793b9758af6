"""The exhaustive matcher: every offset of the search window at every map of a scale grid, then polishing (4.2)."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import ClassVar

import numpy as np

from magiclens.contract.artifacts import Candidates, FloatArray, Scene
from magiclens.contract.stages import Matcher, Progress, silent
from magiclens.kernels.resuming import resumable
from magiclens.matching.channels import Channels, stack_channels
from magiclens.matching.grain import seen_grain
from magiclens.matching.options import LatticeOptions
from magiclens.matching.pool import Pool
from magiclens.matching.rows import match_in_blocks
from magiclens.matching.tuples import Tiles


class Exhaustive(LatticeOptions, Matcher):
    """Exact search over offsets and axis-aligned maps, pruned by a lower bound; best per bucket; polished."""

    type: ClassVar[str] = "exhaustive"
    version: ClassVar[str] = "5"

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Search, polish, sort.

        Raises:
            InputError: some facet reaches no patch at all, or views do not share an eye.
        """
        return match_in_blocks(_match_rows, (self, scene), scene.lens.facets, progress)

    def match_rows(self, scene: Scene, first: int, last: int, progress: Progress = silent) -> Candidates:
        """What ``match`` finds for the facets in rows ``first`` to ``last - 1``.

        What is found for a facet does not depend on the others, so that blocks of rows can be matched anywhere.

        Args:
            scene: the lens and its views.
            first: the first row of facets.
            last: the row after the last.
            progress: is told the share of the search that is done.

        Returns:
            Candidates with arrays (last - first, N, K, ...).

        Raises:
            InputError: some facet reaches no patch at all, or views do not share an eye.
        """
        from magiclens.matching.polishing import finish

        lens, channels, rows, pixels = scene.lens, stack_channels(scene), slice(first, last), self.pixels
        values = channels.tiles(lens.facets, pixels, rows).reshape(-1, len(channels.target), pixels, pixels)
        centres = lens.facet_centres_mm()[rows].reshape(-1, 2) * (1, -1)
        # one row alone is a strided view: kernels would be compiled for it again
        tiles = Tiles(np.ascontiguousarray(values), centres, lens.pitch_mm)
        pool = Pool(len(values), math.ceil(math.sqrt(self.candidates)))
        search_all(self, scene, channels, tiles, pool, progress)
        pool.require_all(lens, first)
        pool.sort()
        finish(pool, scene, channels, rows, self, self.isotropic)
        return pool.candidates(lens, self.candidates)


def _match_rows(given: tuple[Exhaustive, Scene], rows: range, progress: Progress = silent) -> Candidates:
    matcher, scene = given
    return matcher.match_rows(scene, rows.start, rows.stop, progress)


def search_all(
    options: Exhaustive, scene: Scene, channels: Channels, tiles: Tiles, pool: Pool, progress: Progress
) -> None:
    """Search every raster; rasters that share their x axis share its footprint averages.

    Args:
        options: the window and the lattice of maps.
        scene: the lens and its views.
        channels: its views, stacked.
        tiles: of the facets, (F, C, P, P).
        pool: takes the best candidate of each bucket.
        progress: is told the share that is done.
    """
    from magiclens.matching import rasters
    from magiclens.matching.exhaustive_kernels import search
    from magiclens.matching.raster_kernels import average_columns
    from magiclens.optics.medium import image_optics_of

    size, source = scene.lens.source_size_mm, channels.source
    px, window = scene.lens.pitch_mm / options.pixels, options.window_on(scene.lens, pool.buckets)
    grain, optics = seen_grain(scene), image_optics_of(scene)
    scales = [s for s in resolved_scales(options.scales, px, channels.source_px_mm) if s * px < size]
    pairs = [(s, s) for s in scales] if options.isotropic else list(itertools.product(scales, repeat=2))

    if not scales:
        return
    # rows of the source that are in no facet's window are left out
    low, high = tiles.centres[:, 1].min() - window.half, tiles.centres[:, 1].max() + window.half
    axes = {s: rasters.raster_axis(s, px, window.step, size) for s in scales}
    wanted = {s: y.within(low - s * tiles.pitch / 2, high + s * tiles.pitch / 2) for s, y in axes.items()}
    taps = {s: rasters.footprints(y, s * px + grain, size, source.shape[1]) for s, y in axes.items()}
    ends = [(at[wanted[s].start], at[wanted[s].stop - 1] + weights.shape[1]) for s, (at, weights) in taps.items()]
    seen = range(min(first for first, _ in ends), min(max(end for _, end in ends), source.shape[1]))

    @lru_cache(maxsize=1)
    def columns(sx: float) -> FloatArray:
        return average_columns(source, *rasters.footprints(axes[sx], sx * px + grain, size, source.shape[2]), seen)

    for done, (sx, sy) in resumable(list(enumerate(pairs)), *pool.found):
        x, y = axes[sx], axes[sy]
        built = rasters.build_raster(columns(sx), *taps[sy], x, y, options.pixels, wanted[sy])
        counts = x.count, y.count, x.skip, y.skip, x.stride, y.stride
        raster = rasters.Raster(*built, sx, sy, x.spacing_mm, y.spacing_mm, *counts)
        search(tiles, raster, window, not options.isotropic, optics, pool.found)
        progress((done + 1) / len(pairs))


def resolved_scales(scales: tuple[float, ...], px: float, source_px: float) -> tuple[float, ...]:
    """Raise scales at which a tile pixel would see less than half a source pixel.

    Args:
        scales: magnitudes of the map.
        px: side of a tile's pixel, mm.
        source_px: side of a source pixel, mm.

    Returns:
        The scales that are left, from small to large.
    """
    return tuple(sorted({max(scale, 0.5 * source_px / px) for scale in scales}))
