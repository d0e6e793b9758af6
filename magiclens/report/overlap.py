"""How many facets see each point of the source (the paper's figure 7)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import njit

from magiclens.artifacts import Assignment, FloatArray, IntArray, Lens, View
from magiclens.report.data import RunData
from magiclens.report.figure import Figure
from magiclens.report.scales import BLUE_TO_RED, Pixels, Scale
from magiclens.report.sheet import Tile, display, grid

SIDE = 480
FAINT = np.array([[132, 150, 176], [186, 200, 220]], np.float32)
"""What black and white fade to."""
FINER = 4
"""Patches are counted at this multiple of the figure's resolution: many are narrower than its pixels."""


def overlap_map(data: RunData) -> Figure:
    """The heat map in the lens frame, and every source with what no facet sees faded."""
    views = data.scene.views
    fine = overlaps(data.scene.lens, data.assignment, FINER * SIDE)
    counts = coarse(fine)
    most = np.quantile(counts[counts > 0], 0.999, method="nearest") if counts.any() else 1
    scale = Scale(BLUE_TO_RED, 0.0, float(most), whole=True)
    caption = f"at most {counts.max()}; {np.mean(fine > 0):.0%} of the source is seen"
    tiles = [Tile(scale.paint(counts), "How many facets see each point", caption, scale)]
    for name in dict.fromkeys(view.source_name for view in views):
        of_source = [view for view in views if view.source_name == name]
        tiles.append(Tile(faded(of_source[0].source, seen(of_source, counts)), "What they see of it", name))
    return Figure(
        "overlap",
        "Where the facets look",
        grid(tiles),
        "The source as it lies under the lens, blue where no facet looks, red where most do; "
        "then the source itself, faded where no facet ever looks.",
    )


def overlaps(lens: Lens, assignment: Assignment, side: int) -> IntArray:
    """(side, side) int32, lens frame, row 0 at +y: how many facets see the centre of each pixel of the source."""
    patches = (lens.facet_centres_mm() + assignment.offsets_mm).reshape(-1, 2)
    maps = assignment.maps.reshape(-1, 3).astype(np.float64)
    counts: IntArray = _overlaps(patches, maps, lens.pitch_mm / 2, lens.source_size_mm, side)
    return counts


@njit(cache=True)
def _overlaps(patches, maps, half, size, side):
    """Patches are the images of a facet's square under its map: p is in it if M^-1 (p - centre) is in the square."""
    counts = np.zeros((side, side), np.int32)
    pixel = size / side
    for f in range(len(patches)):
        xx, xy, yy = maps[f]
        determinant = xx * yy - xy * xy
        if determinant == 0.0:
            continue
        wide, tall = half * (abs(xx) + abs(xy)), half * (abs(xy) + abs(yy))
        left, top = 0.5 * size + patches[f, 0], 0.5 * size - patches[f, 1]
        for r in range(max(int((top - tall) / pixel), 0), min(int((top + tall) / pixel) + 1, side)):
            for c in range(max(int((left - wide) / pixel), 0), min(int((left + wide) / pixel) + 1, side)):
                x, y = (c + 0.5) * pixel - left, top - (r + 0.5) * pixel
                u, v = (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant
                if -half <= u < half and -half <= v < half:
                    counts[r, c] += 1
    return counts


def coarse(counts: IntArray) -> IntArray:
    """(S, S) from (FINER S, FINER S): the most in each block, so that no patch is lost."""
    rows = np.max([counts[k::FINER] for k in range(FINER)], axis=0)
    return np.asarray(np.max([rows[:, k::FINER] for k in range(FINER)], axis=0))


def seen(views: Iterable[View], counts: IntArray) -> IntArray:
    """Counts (side, side) added up over the views of a source, in the source's own frame."""
    return np.asarray(np.sum([np.rot90(counts, view.quarter_turns) for view in views], axis=0))


def faded(source: FloatArray, counts: IntArray) -> Pixels:
    """(S, S, 3): a source (H, W, C) in linear light, faint where its counts (S, S) are 0."""
    picture = display(source, len(counts)).astype(np.float32)
    faint = FAINT[0] + picture.mean(axis=-1, keepdims=True) / 255 * (FAINT[1] - FAINT[0])
    return np.asarray(np.where(counts[..., None] > 0, picture, faint), np.uint8)
