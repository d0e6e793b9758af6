"""The matcher for several eyes: every normal of a lattice, seen by every eye through exact refraction (4.6)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, IntArray, Scene
from magiclens.contract.stages import Matcher, Progress, silent
from magiclens.contract.units import LengthOrPercent, relative
from magiclens.images import resize, to_display
from magiclens.matching.exhaustive import resolved_scales
from magiclens.matching.grain import seen_grain
from magiclens.matching.options import LatticeOptions
from magiclens.matching.pool import Pool
from magiclens.matching.rows import match_in_blocks
from magiclens.matching.tuples import Levels, PolishingRule

if TYPE_CHECKING:
    from magiclens.matching.multi_view_kernels import Facets, Views


class MultiViewMatcher(LatticeOptions, Matcher):
    """Candidates whose errors count what every eye sees, in position and in shape; best per bucket; polished.

    The paper makes each view the master in turn and follows its patches to the other eyes. Here the lattice is that
    of the mean eye: it holds every normal that a master could ask for.
    """

    type: ClassVar[str] = "multi-view"

    step: LengthOrPercent = Field(relative("0.2mm"), description="distance between neighbouring offsets")

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Search, polish, evaluate.

        Raises:
            InputError: some facet reaches no patch in every view.
        """
        return self.match_at(scene, np.zeros((scene.lens.facets,) * 2), progress)

    def match_at(self, scene: Scene, heights_mm: FloatArray, progress: Progress = silent) -> Candidates:
        """What ``match`` finds for facets whose centres are raised from the reference plane.

        Args:
            scene: the lens and its views.
            heights_mm: (N, N) of the centres.
            progress: is told the share that is done.

        Raises:
            InputError: some facet reaches no patch in every view.
        """
        return self._match(scene, heights_mm, None, progress)

    def rematch(
        self, scene: Scene, candidates: Candidates, assignment: Assignment, built: HeightField, traced: FloatArray,
        progress: Progress = silent,
    ) -> Candidates:  # fmt: skip
        """All candidates polished and evaluated again, with every facet at the height that it now has.

        Its height moves a facet in the pictures of all eyes but the mean one. Facets that now see nothing but the
        source's rim keep the candidates that they had.
        """
        return self._match(scene, built.levels_mm, candidates, progress)

    def _match(self, scene: Scene, heights: FloatArray, known: Candidates | None, progress: Progress) -> Candidates:
        """Candidates for facets at heights (N, N): searched, or those that are known, as they are at these heights."""
        found = match_in_blocks(_match_rows, (self, scene, heights, known), scene.lens.facets, progress)
        return replace(found, heights_mm=heights)

    def _search(self, scene: Scene, pictures: _Pictures, facets: Facets) -> Pool:
        """The best lattice position per bucket for every facet, in no order."""
        from magiclens.matching.multi_view_kernels import BLOCKS, Trials, search_views
        from magiclens.optics.medium import image_optics_of

        lens = scene.lens
        pool = Pool(len(facets.centres), math.ceil(math.sqrt(self.candidates)))
        source_px, block = lens.source_size_mm / pictures.sources.shape[2], lens.pitch_mm / BLOCKS
        scales = resolved_scales(self.scales, block, source_px)
        pairs = [(s, s) for s in scales] if self.isotropic else list(itertools.product(scales, scales))
        grain = seen_grain(scene)
        views = pictures.seen(lens.facets * BLOCKS, 1 / source_px, lens.size_mm)
        boxes = [[(s * block + grain) / source_px for s in pair] for pair in pairs]
        images = np.stack([_averaged(pictures.sources, box) for box in boxes])
        search_views(
            views, facets, Trials(np.array(pairs), images, not self.isotropic),
            self.window_on(lens, pool.buckets), image_optics_of(scene), pool.found,
        )  # fmt: skip
        return pool

    def _finish(self, scene: Scene, pictures: _Pictures, facets: Facets, pool: Pool, progress: Progress) -> None:
        """Polish and evaluate the candidates of a pool; some facets may lose all of theirs."""
        from magiclens.matching.evaluation_kernels import Staircase
        from magiclens.matching.multi_view_kernels import evaluate_views, polish_views
        from magiclens.matching.polishing import ITERATIONS, WIDTHS_MM, blur_levels
        from magiclens.matching.rasters import DISPLAY_TABLE
        from magiclens.optics.medium import image_optics_of

        lens, pixels, window, optics = scene.lens, 2 * self.pixels, self.window_on(scene.lens), image_optics_of(scene)
        per_mm = pictures.sources.shape[2] / lens.source_size_mm
        views, grain = pictures.seen(lens.facets * pixels, per_mm, lens.size_mm), seen_grain(scene)
        images = np.empty((len(WIDTHS_MM), *pictures.sources.shape), np.float32)
        for number, source in enumerate(pictures.sources):
            blur_levels(source, 1 / per_mm, grain, WIDTHS_MM, images[:, number])
        levels, rule = Levels(images, np.array(WIDTHS_MM)), PolishingRule(self.polish, ITERATIONS, self.isotropic)
        polish_views(views, facets, levels, pixels, window, rule, optics, pool.found)
        progress(0.85)
        pool.drop(self.acceptance)
        stairs = Staircase(lens.microfacets, math.nan, DISPLAY_TABLE)  # the scale of flat facets is an eye's own
        evaluate_views(views, facets, pictures.sources, pixels, stairs, window, optics, pool.found)


def _match_rows(
    given: tuple[MultiViewMatcher, Scene, FloatArray, Candidates | None], rows: range, progress: Progress = silent
) -> Candidates:
    matcher, scene, heights, known = given
    some = slice(rows.start, rows.stop)
    lens, pictures, facets = scene.lens, _pictures_of(scene), _facets(scene, heights, some)
    if known is None:
        pool = matcher._search(scene, pictures, facets)
        progress(0.7)
        pool.require_all(lens, rows.start)
        pool.sort()
    else:
        pool = Pool.of(known, some)
    matcher._finish(scene, pictures, facets, pool, progress)
    if known is not None:
        pool.restore(Pool.of(known, some))
    pool.require_all(lens, rows.start)
    pool.drop(matcher.acceptance)
    pool.sort()
    return pool.candidates(lens, matcher.candidates)


@dataclass(frozen=True)
class _Pictures:
    """The pictures of a scene in the lens frame, y down.

    Args:
        sources: (S, C, H, H) float32 linear light, each once.
        which: (V,) source of each view.
        eyes_mm: (V, 3).
        targets: (V, C, T, T) float32 linear light.
    """

    sources: FloatArray
    which: IntArray
    eyes_mm: FloatArray
    targets: FloatArray

    def seen(self, side: int, per_mm: float, size_mm: float) -> Views:
        """The views as kernels take them.

        Args:
            side: pixels along the targets' side.
            per_mm: source pixels per mm.
            size_mm: side of the lens.
        """
        from magiclens.matching.multi_view_kernels import Views

        small = [np.moveaxis(resize(np.moveaxis(t, 0, -1), (side, side)), -1, 0) for t in self.targets]
        targets = np.ascontiguousarray(to_display(np.stack(small)), np.float32)
        return Views(self.eyes_mm, targets, self.which, per_mm, size_mm)


def _pictures_of(scene: Scene) -> _Pictures:
    """All views of a scene; pictures of different sizes are brought to the largest."""
    views = [view.in_lens_frame() for view in scene.views]
    keys = [(view.source_name, view.quarter_turns) for view in scene.views]
    names = list(dict.fromkeys(keys))
    side = max(len(view.source) for view in views)
    across = max(len(view.target) for view in views)
    sources = [resize(views[keys.index(name)].source, (side, side)) for name in names]
    targets = [resize(view.target, (across, across)) for view in views]
    return _Pictures(
        np.ascontiguousarray(np.moveaxis(np.stack(sources), -1, 1)),
        np.array([names.index(key) for key in keys]),
        np.stack([view.eye_mm for view in views]) * (1, -1, 1),
        np.moveaxis(np.stack(targets), -1, 1),
    )


def _averaged(sources: FloatArray, box: Sequence[float]) -> FloatArray:
    """(S, C, H, W) float32 display values of sources averaged over boxes so many pixels wide and tall."""
    from magiclens.matching.polishing import box_blur

    return to_display(np.stack([box_blur(s, box[1], box[0]) for s in sources])).astype(np.float32)


def _facets(scene: Scene, heights_mm: FloatArray, rows: slice) -> Facets:
    """Some rows of the facets of a scene's lens, the centres of all of them at heights (N, N), y down."""
    from magiclens.matching.multi_view_kernels import Facets

    lens = scene.lens
    centres = lens.facet_centres_mm()[rows].reshape(-1, 2) * (1, -1)
    return Facets(centres, np.ascontiguousarray(heights_mm[rows], np.float64).ravel(), lens.pitch_mm)
