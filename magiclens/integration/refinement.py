"""Free-form refinement: facets stop being quadratic lenslets and take the shape that shows their tile best.

Matching gives every facet one affine map of one patch. Such a lenslet is only where to start: its micro-facets can turn
one by one, as long as they stay connected, until every edge in the picture is where it belongs and plain places are
plain. The paper stops at the lenslet (4.5).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter

from magiclens.contract.artifacts import BoolArray, FloatArray, HeightField, Lens, Scene
from magiclens.images import resize, to_display
from magiclens.integration.laplacian import cosines
from magiclens.integration.measures import measures
from magiclens.integration.refinement_kernels import Metric, Samples, Sights, refine_facets
from magiclens.optics.medium import Cut, Optics, optics_of

BLURS = (0.08, 0.03, 0.0)
"""Blurs of the sources, one after the other, of a facet's width: rays find their way down a blurred edge from afar."""
LOOKS = (3, 3, 6)
"""Look-ups of the source along a micro-facet's side, about: what falls between them is shaped by chance."""
ITERATIONS = 3
"""Of conjugate gradients per step."""
PERFECT = 1e-7
"""Mean squared difference of what a facet shows and its tile that is not worth a step."""
ENOUGH = 3e-3
"""A step that lowers a facet's error by a smaller share is its last."""
RESOLUTION, FINEST, COARSEST = 512, 1.5, 0.35
"""Pixels along the lens's side in which its picture is compared; pixels per micro-facet, at most and at least."""
DISPLAY = 8192
"""Entries of the table of display values."""
AT_ONCE = 512
"""Facets between two reports of progress."""

Place = Callable[[FloatArray, FloatArray], FloatArray]
"""From shapes (N, N, k, k), zero mean, and what they stand at (N, N) to what they shall stand at, mm."""


def refine(
    scene: Scene, built: HeightField, rounds: int, progress: Callable[[float], None],
    place: Place | None = None, locked: bool = False,
) -> HeightField:  # fmt: skip
    """A height field whose facets show their tiles better than those of ``built``; others keep their shapes.

    At most ``rounds`` Gauss-Newton steps per facet and blur of the sources. place: facets are raised or lowered so
    before the last blur, which makes up for what they then show elsewhere. locked: the facets' borders stay. A facet
    that would leave the lens's relief keeps its shape.
    """
    facets = _Facets(scene, built, locked)
    progress(0.1)
    for stage, (blur, looks) in enumerate(zip(BLURS, LOOKS, strict=True)):
        if stage == len(BLURS) - 1:
            facets.keep_better(facets.errors())  # others start from their given shapes again, now with a sharp source
            if place:
                facets.stand(place)
        last = facets.descend(blur, looks, rounds, partial(_tell, progress, stage))
    refined = facets.keep_better(last)
    after = replace(built, heights_mm=facets.heights.reshape(built.heights_mm.shape))
    return replace(after, metrics={**built.metrics, **measures(after), "facets_refined": float(refined.mean())})


def foreseen(scene: Scene, built: HeightField) -> FloatArray:
    """(N, N) mean squared differences, in display values, of what facets show and their tiles, if no wall were there.

    Infinite where a ray does not arrive at all.
    """
    return _Facets(scene, built, locked=False).first.reshape(built.levels_mm.shape)


class _Facets:
    """The facets of a height field on their way down.

    heights: (F, k, k) mm. first: (F,) mean squared differences, in display values, of what they showed at first and
    their tiles; infinite where a ray does not arrive. Those that were perfect stay as they are.
    """

    def __init__(self, scene: Scene, built: HeightField, locked: bool):
        k, lens = scene.lens.microfacets + 1, scene.lens
        self._lens, self._optics, self._centres = lens, _optics(built), lens.facet_centres_mm().reshape(-1, 2)
        self._samples = {looks: _samples(lens, looks) for looks in LOOKS}
        finest = self._samples[LOOKS[-1]]
        self._sights = _sights(scene, finest.pixels)
        matrix, eigenvalues = cosines(k)
        self._metric = Metric(np.ascontiguousarray(matrix), eigenvalues / finest.cell_mm**2)
        self._free = np.ones((k, k))
        if locked:
            self._free[[0, -1], :] = self._free[:, [0, -1]] = 0.0
        self.heights = built.heights_mm.reshape(-1, k, k).copy()
        self._given, self._amiss = self.heights.copy(), np.arange(len(self.heights))
        self.first = self.errors()
        self._amiss = np.flatnonzero(self.first > PERFECT)

    def errors(self) -> FloatArray:
        """(F,) errors as they are; inf for perfect ones."""
        return self.descend(0.0, LOOKS[-1], 0, lambda _: None)

    def descend(self, blur: float, looks: int, rounds: int, progress: Callable[[float], None]) -> FloatArray:
        """(F,) errors after at most so many steps; inf for perfect ones. blur: of the sources, of a facet's width."""
        sights, samples = _blurred(self._sights, blur * self._lens.pitch_mm), self._samples[looks]
        errors = np.full(len(self.heights), np.inf)
        for first in range(0, len(self._amiss), AT_ONCE):
            part = self._amiss[first : first + AT_ONCE]
            heights, after = self.heights[part], np.zeros(len(part))
            refine_facets(
                heights, self._centres[part], samples, sights, self._optics, self._metric, self._free,
                rounds, ITERATIONS, ENOUGH, after,
            )  # fmt: skip
            self.heights[part], errors[part] = heights, after
            progress(min(1.0, (first + AT_ONCE) / len(self._amiss)))
        return errors

    def stand(self, place: Place) -> None:
        """Raise or lower facets, and their given shapes with them, to where ``place`` wants them."""
        n, k = self._lens.facets, self._lens.microfacets + 1
        levels = self.heights.mean(axis=(1, 2))
        shapes = (self.heights - levels[:, None, None]).reshape(n, n, k, k)
        rise = (place(shapes, levels.reshape(n, n)).ravel() - levels)[:, None, None]
        rise[np.abs(self._given + rise).max(axis=(1, 2)) > self._lens.relief_mm] = 0.0
        self.heights, self._given = self.heights + rise, self._given + rise

    def keep_better(self, errors: FloatArray) -> BoolArray:
        """Give facets their given shapes back unless errors (F,) are lower than at first; (F,) where they are."""
        better: BoolArray = (errors < self.first) & (np.abs(self.heights).max(axis=(1, 2)) <= self._lens.relief_mm)
        self.heights = np.where(better[:, None, None], self.heights, self._given)
        return better


def _tell(progress: Callable[[float], None], stage: int, done: float) -> None:
    progress(0.1 + 0.9 * (stage + done) / len(BLURS))


def _samples(lens: Lens, looks: int) -> Samples:
    m = lens.microfacets
    pixels = round(min(max(RESOLUTION / lens.facets, COARSEST * m), FINEST * m))
    per_pixel = max(2, round(looks * m / pixels))
    cell, side = (lens.pitch_mm - lens.wall_mm) / m, pixels * per_pixel
    at = (np.arange(side) + 0.5) * m / side
    right, down = (a.ravel() for a in np.meshgrid(at, at))
    i, j = down.astype(int), right.astype(int)
    upper = (right - j > down - i).astype(int)
    triangle = 2 * (i * m + j) + upper
    pixel = np.add.outer(np.arange(side) // per_pixel * pixels, np.arange(side) // per_pixel).ravel()
    pairs, pair = np.unique(pixel * (2 * m * m) + triangle, return_inverse=True)
    return Samples(
        cell, pixels, side, triangle, (right - j - (1 + upper) / 3) * cell, (i + (2 - upper) / 3 - down) * cell,
        pair, pairs // (2 * m * m), pairs % (2 * m * m),
    )  # fmt: skip


def _optics(built: HeightField) -> Optics:
    """What a height field refracts with; the eye of vertical cells makes no difference."""
    eye = np.zeros(3) if built.eye_mm is None else np.asarray(built.eye_mm, float)
    return optics_of(built.lens, Cut(eye, built.eye_mm is None))


def _sights(scene: Scene, pixels: int) -> Sights:
    """Views side by side that share an eye in the lens frame; equal sources are kept once."""
    lens, given = scene.lens, sorted(scene.views, key=lambda view: tuple(view.eye_in_lens_frame_mm.round(6)))
    views = [view.in_lens_frame() for view in given]
    colours, side = views[0].source.shape[2], max(len(view.source) for view in views)
    names = [(view.source_name, view.quarter_turns) for view in given]
    sources = {name: resize(view.source, (side, side)) for name, view in zip(names, views, strict=True)}
    places = {name: k * colours for k, name in enumerate(sources)}
    eyes, first = np.unique([view.eye_mm.round(6) for view in views], axis=0, return_index=True)
    targets = [resize(view.target, (lens.facets * pixels,) * 2) for view in views]
    return Sights(
        eyes,
        np.append(first, len(views)) * colours,
        np.concatenate([places[name] + np.arange(colours) for name in names]),
        np.concatenate(list(sources.values()), axis=-1),
        lens.source_size_mm,
        to_display(np.concatenate(targets, axis=-1)),
        lens.size_mm,
        to_display(np.linspace(0, 1, DISPLAY, dtype=np.float32)),
    )


def _blurred(sights: Sights, blur_mm: float) -> Sights:
    sigma = blur_mm * len(sights.sources) / sights.source_mm
    return sights._replace(sources=gaussian_filter(sights.sources, (sigma, sigma, 0), mode="constant"))
