"""Free-form refinement: facets stop being quadratic lenslets and take the shape that shows their tile best.

Matching gives every facet one affine map of one patch. Such a lenslet is only where to start: its micro-facets can turn
one by one, as long as they stay connected, until every edge in the picture is where it belongs and plain places are
plain. The paper stops at the lenslet (4.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter

from magiclens.artifacts import FloatArray, HeightField, Lens, Scene
from magiclens.images import resize, to_display
from magiclens.integration.freeform import Metric, Samples, Sights, Slab, refine_facets
from magiclens.integration.measures import measures
from magiclens.integration.two_level import cosines

BLURS = (0.08, 0.03, 0.0)
"""Blurs of the sources, one after the other, of a facet's width: rays find their way down a blurred edge from afar."""
ITERATIONS = 3
"""Of conjugate gradients per step."""
ENOUGH = 3e-3
"""A step that lowers a facet's error by a smaller share is its last."""
RESOLUTION, FINEST, COARSEST = 512, 1.5, 0.35
"""Pixels along the lens's side in which its picture is compared; pixels per micro-facet, at most and at least."""
LOOKS = 3
"""Look-ups of the source along a micro-facet's side, about."""
DISPLAY = 8192
"""Entries of the table of display values."""
AT_ONCE = 512
"""Facets between two reports of progress."""


def refine(
    scene: Scene, built: HeightField, rounds: int, locked: bool, progress: Callable[[float], None]
) -> HeightField:
    """A height field whose facets show their tiles better than those of ``built``; none shows its tile worse.

    At most ``rounds`` Gauss-Newton steps per facet and blur of the sources. locked: the facets' borders stay. A facet
    that would leave the lens's relief stays as it was.
    """
    facets = _Facets(scene, built, locked)
    first = facets.descend(0.0, 0, lambda done: progress(0.1 * done))[:, 0]
    for stage, blur in enumerate(BLURS):
        last = facets.descend(blur, rounds, partial(_tell, progress, stage))[:, 1]
    worse = ~(last < first) | (np.abs(facets.heights).max(axis=(1, 2)) > scene.lens.relief_mm)
    given = built.heights_mm.reshape(facets.heights.shape)
    heights = np.where(worse[:, None, None], given, facets.heights).reshape(built.heights_mm.shape)
    refined = replace(built, heights_mm=heights)
    return replace(refined, metrics={**built.metrics, **measures(refined), "facets_refined": float((~worse).mean())})


def foreseen(scene: Scene, built: HeightField) -> FloatArray:
    """(N, N) mean squared differences, in display values, of what facets show and their tiles, if no wall were there.

    Infinite where a ray does not arrive at all.
    """
    errors: FloatArray = _Facets(scene, built, locked=False).descend(0.0, 0, lambda _: None)[:, 0]
    return errors.reshape(built.levels_mm.shape)


class _Facets:
    """The facets of a height field on their way down; ``heights``: (F, k, k) mm."""

    def __init__(self, scene: Scene, built: HeightField, locked: bool):
        k, lens = scene.lens.microfacets + 1, scene.lens
        matrix, eigenvalues = cosines(k)
        self._samples, self._slab = _samples(lens), _slab(lens, built.eye_mm)
        self._sights = _sights(scene, self._samples.pixels)
        self._metric = Metric(np.ascontiguousarray(matrix), eigenvalues / self._samples.cell_mm**2)
        self._free = np.ones((k, k))
        if locked:
            self._free[[0, -1], :] = self._free[:, [0, -1]] = 0.0
        self._pitch_mm, self._centres = lens.pitch_mm, lens.facet_centres_mm().reshape(-1, 2)
        self.heights = built.heights_mm.reshape(-1, k, k).copy()

    def descend(self, blur: float, rounds: int, progress: Callable[[float], None]) -> FloatArray:
        """(F, 2) errors before and after at most so many steps with sources blurred by this share of a facet."""
        sights = _blurred(self._sights, blur * self._pitch_mm)
        errors = np.zeros((len(self.heights), 2))
        for first in range(0, len(errors), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            refine_facets(
                self.heights[part], self._centres[part], self._samples, sights, self._slab, self._metric, self._free,
                rounds, ITERATIONS, ENOUGH, errors[part],
            )  # fmt: skip
            progress(min(1.0, (first + AT_ONCE) / len(errors)))
        return errors


def _tell(progress: Callable[[float], None], stage: int, done: float) -> None:
    progress(0.1 + 0.9 * (stage + done) / len(BLURS))


def _samples(lens: Lens) -> Samples:
    m = lens.microfacets
    pixels = round(min(max(RESOLUTION / lens.facets, COARSEST * m), FINEST * m))
    looks = max(2, round(LOOKS * m / pixels))
    cell, side = (lens.pitch_mm - lens.wall_mm) / m, pixels * looks
    at = (np.arange(side) + 0.5) * m / side
    right, down = (a.ravel() for a in np.meshgrid(at, at))
    i, j = down.astype(int), right.astype(int)
    upper = (right - j > down - i).astype(int)
    triangle = 2 * (i * m + j) + upper
    pixel = np.add.outer(np.arange(side) // looks * pixels, np.arange(side) // looks).ravel()
    pairs, pair = np.unique(pixel * (2 * m * m) + triangle, return_inverse=True)
    return Samples(
        cell, pixels, side, triangle, (right - j - (1 + upper) / 3) * cell, (i + (2 - upper) / 3 - down) * cell,
        pair, pairs // (2 * m * m), pairs % (2 * m * m),
    )  # fmt: skip


def _slab(lens: Lens, cut_eye: FloatArray | None) -> Slab:
    upright = np.array([0.0, 0.0, np.inf])
    limit = math.cos(math.radians(lens.max_slope_deg))
    return Slab(
        upright if cut_eye is None else np.asarray(cut_eye, float), lens.thickness_mm, lens.gap_mm, lens.ior, limit
    )


def _sights(scene: Scene, pixels: int) -> Sights:
    """Views side by side that share an eye in the lens frame; equal sources are kept once."""
    lens, given = scene.lens, sorted(scene.views, key=lambda view: tuple(view.in_lens_frame().eye_mm.round(6)))
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
