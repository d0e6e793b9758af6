"""Free-form refinement: facets stop being quadratic lenslets and take the shape that shows their tile best.

Matching gives every facet one affine map of one patch. Such a lenslet is only where to start: its micro-facets can turn
one by one, as long as they stay connected, until every edge in the picture is where it belongs and plain areas are
plain. The paper stops at the lenslet (4.5).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from magiclens.contract.artifacts import BoolArray, FloatArray, HeightField, Lens, Scene
from magiclens.images import resize, to_display
from magiclens.integration.laplacian import cosines
from magiclens.integration.levels import excursions
from magiclens.integration.refinement_kernels import Descent, Metric, Pictures, Samples, refine_facets
from magiclens.integration.surface_metrics import surface_metrics
from magiclens.kernels.spreading import shares, spread
from magiclens.optics.medium import Cut, Optics, optics_of

_BLURS = (0.08, 0.03)
"""Blurs of the sources, one after the other, in facet widths. A blurred edge has a gradient even far away from it."""
_SHARP = 0.0
"""The last one."""
_LEAST_BLUR = 0.1
"""Least blur of the sources, in widths of a micro-facet: a look-up stands for a piece of one."""
_LEAST_SIGMA = 0.125
"""A Gaussian of a smaller sigma, pixels, leaves a picture as it is: SciPy's ends after four sigmas."""
_ITERATIONS = 4
"""Iterations of conjugate gradients per step."""
_PERFECT = 1e-7
"""Mean squared difference of what a facet shows and its tile that is not worth a step."""
_ENOUGH = 5e-3
"""A step that lowers a facet's error by a smaller share is its last."""
_RESOLUTION = 512
"""Number of pixels along the lens's side in which its picture is compared, within the bounds below."""
_FINEST, _COARSEST = 1.5, 0.35
"""Most and least pixels along a micro-facet's side."""
_LEAST_PIECE = 1e-9
"""Share of a cell that is a piece of it, and not rounding."""
_DISPLAY_ENTRIES = 8192
"""Number of entries of the table of display values."""
FACETS_AT_ONCE = 512
"""Most facets between two reports of progress."""
_LEAST_REPORTS = 4
"""Least reports of progress on all facets, but for one each."""
_FINER = 32
"""A worker of a cluster gets no fewer facets at once than its share divided by this; see ``shares``."""

Relevel = Callable[[FloatArray, FloatArray], FloatArray]
"""From shapes (N, N, k, k) of zero mean, mm, and facets' levels (N, N), mm, to new levels (N, N), mm."""


def refine(
    scene: Scene, built: HeightField, rounds: int, progress: Callable[[float], None],
    relevel: Relevel | None = None, locked: bool = False,
) -> HeightField:  # fmt: skip
    """Turn the micro-facets of a height field so that its facets show their tiles better.

    Args:
        scene: the lens and its views.
        built: lenslets to begin with.
        rounds: Gauss-Newton steps per facet and blur of the sources, at most.
        progress: is told the share of the work that is done.
        relevel: gives the facets new levels before the last blur, which corrects what they then show amiss; None
            leaves the levels.
        locked: whether the facets' border vertices stay.

    Returns:
        The refined height field. A facet that is not better for it, or that would leave the lens's relief, keeps its
        shape.
    """
    facets, (wide, narrow) = _Facets(scene, built, locked), _BLURS
    errors = facets.begin(
        [(_SHARP, 0), (wide, rounds), (narrow, rounds), (_SHARP, 0)], lambda done: progress(0.72 * done)
    )
    # facets that blurred sources made worse start from their given shapes again, now with a sharp source
    facets.keep_better(errors[-1])
    if relevel:
        facets.relevel(relevel)
    errors = facets.descend([(_SHARP, rounds)], lambda done: progress(0.72 + 0.28 * done))
    refined = facets.keep_better(errors[-1])
    after = replace(built, heights_mm=facets.heights.reshape(built.heights_mm.shape))
    metrics = {**built.metrics, **surface_metrics(after), "facets_refined": float(refined.mean())}
    return replace(after, metrics=metrics)


def predicted_errors(scene: Scene, built: HeightField) -> FloatArray:
    """(N, N) mean squared differences, in display values, of what facets show and their tiles, if no wall were there.

    Infinite where a ray does not arrive at all.
    """
    facets = _Facets(scene, built, locked=False)
    facets.begin([(_SHARP, 0)])
    return facets.first.reshape(built.levels_mm.shape)


class _Facets:
    """The facets of a height field while they are refined. Those that are perfect at first stay as they are.

    Attributes:
        heights: (F, k, k) mm, as they are now.
        first: (F,) mean squared differences, in display values, of what the facets showed at first and their tiles, see
            ``begin``; infinite where a ray does not arrive.
    """

    def __init__(self, scene: Scene, built: HeightField, locked: bool):
        k, lens = scene.lens.microfacets + 1, scene.lens
        self._lens, self._centres, samples = lens, lens.facet_centres_mm().reshape(-1, 2), samples_of(lens)
        matrix, eigenvalues = cosines(k)
        free = np.ones((k, k))
        if locked:
            free[[0, -1], :] = free[:, [0, -1]] = 0.0
        metric = Metric(np.ascontiguousarray(matrix), eigenvalues / samples.cell_mm**2, free)
        self._common = _Common(pictures_of(scene, samples.pixels), samples, optics_for(built), metric)
        self.heights = built.heights_mm.reshape(-1, k, k).copy()
        self._given, self._imperfect = self.heights.copy(), np.arange(len(self.heights))
        self.first = np.full(len(self.heights), np.inf)

    def begin(self, passes: list[tuple[float, int]], progress: Callable[[float], None] = lambda _: None) -> FloatArray:
        """Find ``first`` in the first of some passes, which has no steps; returns what ``descend`` returns."""
        errors = self.descend(passes, progress)
        self.first = errors[0]
        self._imperfect = np.flatnonzero(self.first > _PERFECT)
        return errors

    def descend(self, passes: list[tuple[float, int]], progress: Callable[[float], None]) -> FloatArray:
        """Take steps with all facets that are not perfect.

        Args:
            passes: one after the other with each facet: blur of the sources, in facet widths, and steps, at most.
            progress: is told the share of the facets that are done.

        Returns:
            (passes, F) mean squared errors, in display values; inf for perfect ones.
        """
        least_mm = _LEAST_BLUR * self._common.samples.cell_mm
        descents = [
            (max(blur * self._lens.pitch_mm, least_mm), Descent(rounds, _ITERATIONS, _ENOUGH))
            for blur, rounds in passes
        ]
        errors = np.full((len(passes), len(self.heights)), np.inf)
        at_once = min(FACETS_AT_ONCE, max(len(self._imperfect) // _LEAST_REPORTS, 1))
        blocks = shares(len(self._imperfect), _FINER, at_once)
        facets = [self._imperfect[block.start : block.stop] for block in blocks]
        parts = [_Part(self.heights[f], self._centres[f], descents) for f in facets]
        for done, (heights, after) in spread(_descended, self._common, parts, self.heights, errors):
            self.heights[facets[done]], errors[:, facets[done]] = heights, after
            progress((done + 1) / len(parts))
        return errors

    def relevel(self, levels_for: Relevel) -> None:
        """Raise or lower facets, and their given shapes with them; a facet that would leave the relief stays."""
        n, k = self._lens.facets, self._lens.microfacets + 1
        levels = self.heights.mean(axis=(1, 2))
        shapes = (self.heights - levels[:, None, None]).reshape(n, n, k, k)
        rise = levels_for(shapes, levels.reshape(n, n)).ravel() - levels
        rise[excursions(self._given, rise) > self._lens.relief_mm] = 0.0
        self.heights += rise[:, None, None]
        self._given += rise[:, None, None]

    def keep_better(self, errors: FloatArray) -> BoolArray:
        """Give facets their given shapes back unless errors (F,) are lower than at first; returns (F,) where so."""
        better: BoolArray = (errors < self.first) & (excursions(self.heights) <= self._lens.relief_mm)
        self.heights = np.where(better[:, None, None], self.heights, self._given)
        return better


class _Common:
    """What all facets have in common while they are refined."""

    def __init__(self, pictures: Pictures, samples: Samples, optics: Optics, metric: Metric):
        self._pictures, self.samples, self.optics, self.metric = pictures, samples, optics, metric
        self._last: dict[float, Pictures] = {}

    def pictures(self, blur_mm: float) -> Pictures:
        """The pictures with blurred sources; the last three are kept, for the next block of facets."""
        asked = self._last.pop(blur_mm, None) or blurred(self._pictures, blur_mm)
        self._last = dict([*list(self._last.items())[-2:], (blur_mm, asked)])
        return asked


class _Part(NamedTuple):
    """Facets that take steps, see ``_Facets.descend``.

    Attributes:
        descents: One after the other: blur of the sources, mm, and when steps end.
    """

    heights: FloatArray
    centres: FloatArray
    descents: list[tuple[float, Descent]]


def _descended(common: _Common, part: _Part) -> tuple[FloatArray, FloatArray]:
    """Heights and errors of facets after their steps. It may be called again with the same part, on other machines."""
    heights, left = part.heights.copy(), np.arange(len(part.heights))
    errors = np.full((len(part.descents), len(heights)), np.inf)
    for number, (blur_mm, descent) in enumerate(part.descents):
        moved, after = heights[left], np.zeros(len(left))
        refine_facets(
            moved, part.centres[left], common.samples, common.pictures(blur_mm), common.optics, common.metric,
            descent, after,
        )  # fmt: skip
        heights[left], errors[number, left] = moved, after
        if descent.rounds == 0:
            left = left[after > _PERFECT]
    return heights, errors


def samples_of(lens: Lens) -> Samples:
    """Where the facets of a lens are sampled."""
    m = lens.microfacets
    pixels = round(min(max(_RESOLUTION / lens.facets, _COARSEST * m), _FINEST * m))
    cell = (lens.pitch_mm - lens.wall_mm) / m
    # the sides of pixels and of cells cut the facet into rectangles, each within one of either
    lines = np.union1d(np.arange(pixels + 1) * m, np.arange(m + 1) * pixels)
    of_cell, first = np.divmod(lines[:-1], pixels)
    area, right, down = _halves(first / pixels, (first + np.diff(lines)) / pixels)
    upper, row, column = np.nonzero(area > _LEAST_PIECE)
    area, right, down = (a[upper, row, column] for a in (area, right, down))
    of_pixel, i, j = lines[:-1] // m, of_cell[row], of_cell[column]
    # triangles' centroids lie a third of a cell from the right angle, which is at the lower left or at the upper right
    right, up = right - (1 + upper) / 3, (2 - upper) / 3 - down
    pixel, triangle = of_pixel[row] * pixels + of_pixel[column], (upper * m + i) * m + j
    # a piece's layer is the number of those of its pixel before it
    order = np.lexsort((triangle, pixel))
    layer = np.empty_like(pixel)
    layer[order] = np.arange(len(pixel)) - np.searchsorted(pixel[order], pixel[order])
    of_pixels = np.argsort(-np.bincount(pixel), kind="stable")
    order = np.lexsort((np.argsort(of_pixels)[pixel], layer))
    upper_of, i_of, j_of = np.indices((2, m, m)).reshape(3, -1)
    return Samples(
        cell,
        pixels,
        np.stack([j_of + (1 + upper_of) / 3 - m / 2, m / 2 - i_of - (2 - upper_of) / 3]) * cell,
        of_pixels,
        np.append(0, np.bincount(layer).cumsum()),
        triangle[order].astype(np.uint32),  # without signs, so that kernels need not look for negative indices
        (right[order] * cell).astype(np.float32),
        (up[order] * cell).astype(np.float32),
        (area[order] * (pixels / m) ** 2).astype(np.float32),
    )


def _halves(first: FloatArray, end: FloatArray) -> FloatArray:
    """The parts of rectangles at the lower left and at the upper right of their cells' diagonals.

    Args:
        first: (E,) where the rows and the columns of rectangles begin in their cells, whose side is 1.
        end: (E,) where they end.

    Returns:
        (3, 2, E, E) areas, lower left first, and where the centroids lie, to the right and downward in their cells.
    """
    y0, y1, x0, x1 = first[:, None], end[:, None], first, end
    # integrals of 1, x and y over y < x: as far as a, rows are whole; from there to b, they begin at the diagonal
    a, b = np.clip(x0, y0, y1), np.clip(x1, y0, y1)
    upper = np.stack([
        (x1 - x0) * (a - y0) + x1 * (b - a) - (b**2 - a**2) / 2,
        ((x1**2 - x0**2) * (a - y0) + x1**2 * (b - a)) / 2 - (b**3 - a**3) / 6,
        ((x1 - x0) * (a**2 - y0**2) + x1 * (b**2 - a**2)) / 2 - (b**3 - a**3) / 3,
    ])  # fmt: skip
    whole = (x1 - x0) * (y1 - y0) * np.stack(np.broadcast_arrays(1.0, (x0 + x1) / 2, (y0 + y1) / 2))
    parts: FloatArray = np.stack([whole - upper, upper], axis=1)
    parts[1:] /= np.maximum(parts[0], _LEAST_PIECE)
    return parts


def optics_for(built: HeightField) -> Optics:
    """What a height field refracts with; the eye of vertical cells makes no difference."""
    # a copy: to numba, arrays that are read-only are another type, for which it would compile the kernels again
    eye = np.zeros(3) if built.eye_mm is None else np.array(built.eye_mm, float)
    return optics_of(built.lens, Cut(eye, built.eye_mm is None))


def pictures_of(scene: Scene, pixels: int) -> Pictures:
    """What the eyes of a scene see and should see, lens frame.

    The channels of views that share an eye in the lens frame follow each other; equal sources are kept once.

    Args:
        scene: the lens and its views.
        pixels: target pixels along a facet's side.
    """
    # rounded, so that eyes that differ by rounding are one; sorted as np.unique sorts, so that ``first`` is right
    lens, given = scene.lens, sorted(scene.views, key=lambda view: tuple(view.eye_in_lens_frame_mm.round(6)))
    views = [view.in_lens_frame() for view in given]
    colours, side = views[0].source.shape[2], max(len(view.source) for view in views)
    # in the lens frame a source at another rotation is another picture
    names = [(view.source_name, view.quarter_turns) for view in given]
    sources = {name: resize(view.source, (side, side)) for name, view in zip(names, views, strict=True)}
    planes = {name: k * colours for k, name in enumerate(sources)}
    eyes, first = np.unique([view.eye_mm.round(6) for view in views], axis=0, return_index=True)
    targets = [resize(view.target, (lens.facets * pixels,) * 2) for view in views]
    return Pictures(
        eyes,
        np.append(first, len(views)) * colours,
        np.concatenate([planes[name] + np.arange(colours) for name in names]),
        np.concatenate(list(sources.values()), axis=-1),
        lens.source_size_mm,
        to_display(np.concatenate(targets, axis=-1)),
        lens.size_mm,
        to_display(np.linspace(0, 1, _DISPLAY_ENTRIES, dtype=np.float32)),
    )


def blurred(pictures: Pictures, blur_mm: float) -> Pictures:
    """The same with sources blurred by a Gaussian of this sigma, mm; beside the sources it is dark, as for look-ups."""
    sigma = blur_mm * len(pictures.sources) / pictures.source_mm
    if sigma < _LEAST_SIGMA:
        return pictures
    return pictures._replace(sources=gaussian_filter(pictures.sources, (sigma, sigma, 0), mode="constant"))
