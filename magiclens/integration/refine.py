"""Free-form refinement: facets stop being quadratic lenslets and take the shape that shows their tile best.

Matching gives every facet one affine map of one patch. Such a lenslet is only where to start: its micro-facets can turn
one by one, as long as they stay connected, until every edge in the picture is where it belongs and plain places are
plain. The paper stops at the lenslet (4.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from magiclens.artifacts import FloatArray, HeightField, Lens, Scene
from magiclens.images import resize, to_display
from magiclens.integration.freeform import Metric, Samples, Sights, Slab, refine_facets
from magiclens.integration.measures import measures
from magiclens.integration.two_level import cosines

BLURS = (0.08, 0.03, 0.0)
"""Blurs of the sources, one after the other, of a facet's width: rays find their way down a blurred edge from afar."""
ITERATIONS = 6
"""Of conjugate gradients per step."""
ENOUGH = 3e-3
"""A step that lowers a facet's error by a smaller share is its last."""
RESOLUTION, FINEST, COARSEST = 512, 1.5, 0.75
"""Pixels along the lens's side in which its picture is compared; pixels per micro-facet, at most and at least."""
LOOKS = 3
"""Look-ups of the source along a micro-facet's side, about."""
DISPLAY = 8192
"""Entries of the table of display values."""
ROWS = 16
"""Facet rows between two reports of progress."""


def refine(
    scene: Scene, built: HeightField, rounds: int, locked: bool, progress: Callable[[float], None]
) -> HeightField:
    """A height field whose facets show their tiles better than those of ``built``; none shows its tile worse.

    At most ``rounds`` Gauss-Newton steps per facet and blur of the sources. locked: the facets' borders stay. A facet
    that would leave the lens's relief stays as it was.
    """
    lens, n, m = scene.lens, scene.lens.facets, scene.lens.microfacets
    samples, slab = _samples(lens), _slab(lens, built.eye_mm)
    matrix, eigenvalues = cosines(m + 1)
    metric = Metric(np.ascontiguousarray(matrix), eigenvalues / samples.cell_mm**2)
    free = np.ones((m + 1, m + 1))
    if locked:
        free[[0, -1], :] = free[:, [0, -1]] = 0.0
    given = np.ascontiguousarray(built.heights_mm).reshape(n * n, m + 1, m + 1)
    heights, centres = given.copy(), lens.facet_centres_mm().reshape(-1, 2)
    errors, first = np.zeros((n * n, 2)), np.zeros((n * n, 2))

    def descend(blur: float, steps: int, errors: FloatArray, done: float, share: float) -> None:
        sights = _sights(scene, samples.pixels, blur * lens.pitch_mm)
        for row in range(0, n, ROWS):
            part = slice(row * n, (row + ROWS) * n)
            refine_facets(
                heights[part],
                centres[part],
                samples,
                sights,
                slab,
                metric,
                free,
                steps,
                ITERATIONS,
                ENOUGH,
                errors[part],
            )
            progress(done + share * min(1.0, (row + ROWS) / n))

    descend(0.0, 0, first, 0.0, 0.1)
    for stage, blur in enumerate(BLURS):
        descend(blur, rounds, errors, 0.1 + 0.9 * stage / len(BLURS), 0.9 / len(BLURS))
    worse = ~(errors[:, 1] < first[:, 0]) | (np.abs(heights).max(axis=(1, 2)) > lens.relief_mm)
    heights[worse] = given[worse]
    return _measured(replace(built, heights_mm=heights.reshape(n, n, m + 1, m + 1)), float((~worse).mean()))


def _measured(refined: HeightField, share: float) -> HeightField:
    return replace(refined, metrics={**refined.metrics, **measures(refined), "facets_refined": share})


def _samples(lens: Lens) -> Samples:
    m = lens.microfacets
    pixels = round(min(max(RESOLUTION / lens.facets, COARSEST * m), FINEST * m))
    looks = max(2, round(LOOKS * m / pixels))
    cell, side = lens.pitch_mm / m, pixels * looks
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


def _sights(scene: Scene, pixels: int, blur_mm: float) -> Sights:
    """Views side by side that share an eye in the lens frame, their sources blurred; equal sources are kept once."""
    lens, given = scene.lens, sorted(scene.views, key=lambda view: tuple(view.in_lens_frame().eye_mm.round(6)))
    views = [view.in_lens_frame() for view in given]
    colours, side = views[0].source.shape[2], max(len(view.source) for view in views)
    sigma = blur_mm * side / lens.source_size_mm
    names = [(view.source_name, view.quarter_turns) for view in given]
    sources = {name: resize(view.source, (side, side)) for name, view in zip(names, views, strict=True)}
    places = {name: k * colours for k, name in enumerate(sources)}
    eyes, first = np.unique([view.eye_mm.round(6) for view in views], axis=0, return_index=True)
    targets = [np.moveaxis(resize(view.target, (lens.facets * pixels,) * 2), -1, 0) for view in views]
    return Sights(
        eyes,
        np.append(first, len(views)) * colours,
        np.concatenate([places[name] + np.arange(colours) for name in names]),
        np.concatenate([gaussian_filter(s, (sigma, sigma, 0), mode="constant") for s in sources.values()], axis=-1),
        lens.source_size_mm,
        to_display(np.concatenate(targets)),
        lens.size_mm,
        to_display(np.linspace(0, 1, DISPLAY, dtype=np.float32)),
    )
