"""How many facets see each point of the source (the paper's figure 7)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from magiclens.contract.artifacts import Assignment, FloatArray, IntArray, Lens, Scene, View
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import BLUE_TO_RED, ColourScale, Pixels
from magiclens.drawing.tiles import Tile, to_pixels, wrap_tiles
from magiclens.geometry.facets import Patches, patches_seen

SIDE = 480
FAINT = np.array([[132, 150, 176], [186, 200, 220]], np.float32)
"""What black and white fade to."""
FINER = 4
"""Patches are counted at this multiple of the figure's resolution: many are narrower than its pixels."""


def overlap_map(data: RunResult) -> Figure:
    """The heat map in the lens frame, and every source with what no facet sees faded."""
    views, levels = data.scene.views, data.height_field.levels_mm
    eyes = [tuple(view.eye_in_lens_frame_mm.round(6)) for view in views]
    seen_by = {eye: patches_seen(data.scene, data.assignment, np.array(eye), levels) for eye in eyes}
    each = {eye: overlaps(data.scene.lens, patches, FINER * SIDE) for eye, patches in seen_by.items()}
    fine = np.asarray(np.sum(list(each.values()), axis=0))
    counts = coarse(fine)
    most = np.quantile(counts[counts > 0], 0.999, method="nearest") if counts.any() else 1
    scale = ColourScale(BLUE_TO_RED, 0.0, float(most), whole=True)
    together = f" for {len(each)} eyes" if len(each) > 1 else ""
    caption = f"at most {counts.max()}{together}; {np.mean(fine > 0):.0%} of the source is seen"
    tiles = [Tile(scale.paint(counts), "How many facets see each point", caption, scale)]
    if data.matched:
        tiles.append(_matched(data.scene, data.matched))
    for name in dict.fromkeys(view.source_name for view in views):
        of_source = [k for k, view in enumerate(views) if view.source_name == name]
        shown = seen([views[k] for k in of_source], [coarse(each[eyes[k]]) for k in of_source])
        tiles.append(Tile(faded(views[of_source[0]].source, shown), "What they see of it", name))
    return Figure(
        "overlap",
        "Where the facets look",
        wrap_tiles(tiles),
        "The source as it lies under the lens, blue where no facet looks, red where most do; "
        "then the source itself, faded where no facet ever looks.",
    )


def _matched(scene: Scene, matched: Assignment) -> Tile:
    """The heat map of a lens whose facets may look anywhere, on a scale of its own, as it sees much more often."""
    patches = patches_seen(scene, matched, scene.views[0].eye_in_lens_frame_mm)
    fine = overlaps(scene.lens, patches, FINER * SIDE)
    counts = coarse(fine)
    scale = ColourScale(BLUE_TO_RED, 0.0, float(counts.max()), whole=True)
    caption = f"at most {counts.max()}; {np.mean(fine > 0):.0%} of the source is seen"
    return Tile(scale.paint(counts), "A lens matched to the first source", caption, scale)


def overlaps(lens: Lens, patches: Patches, side: int) -> IntArray:
    """(side, side) int32, lens frame, row 0 at +y: through how many facets the centre of each source pixel is seen."""
    return _counted(lens, patches, side)[0]


def facets_that_look(lens: Lens, patches: Patches, side: int) -> IntArray:
    """(side, side) int32, as ``overlaps``: the facet through which each source pixel is seen, row * N + column, or -1.

    Where several do, the last of them.
    """
    return _counted(lens, patches, side)[1]


def _counted(lens: Lens, patches: Patches, side: int) -> tuple[IntArray, IntArray]:
    landings, maps = patches.landings_mm.reshape(-1, 2), np.ascontiguousarray(patches.maps.reshape(-1, 4))
    counts, last = _overlaps(landings, maps, lens.pitch_mm / 2, lens.source_size_mm, side)
    return counts, last


@njit(cache=True)
def _overlaps(patches, maps, half, size, side):
    """Patches are the images of a facet's square under its map: p is in it if M^-1 (p - centre) is in the square."""
    counts, last = np.zeros((side, side), np.int32), np.full((side, side), -1, np.int32)
    pixel = size / side
    for f in range(len(patches)):
        xx, xy, yx, yy = maps[f]
        determinant = xx * yy - xy * yx
        if determinant == 0.0 or math.isnan(determinant):
            continue
        wide, tall = half * (abs(xx) + abs(xy)), half * (abs(yx) + abs(yy))
        left, top = 0.5 * size + patches[f, 0], 0.5 * size - patches[f, 1]
        for r in range(max(int((top - tall) / pixel), 0), min(int((top + tall) / pixel) + 1, side)):
            for c in range(max(int((left - wide) / pixel), 0), min(int((left + wide) / pixel) + 1, side)):
                x, y = (c + 0.5) * pixel - left, top - (r + 0.5) * pixel
                u, v = (yy * x - xy * y) / determinant, (xx * y - yx * x) / determinant
                if -half <= u < half and -half <= v < half:
                    counts[r, c] += 1
                    last[r, c] = f
    return counts, last


def coarse(counts: IntArray) -> IntArray:
    """(S, S) from (FINER S, FINER S): the most in each block, so that no patch is lost."""
    rows = np.max([counts[k::FINER] for k in range(FINER)], axis=0)
    return np.asarray(np.max([rows[:, k::FINER] for k in range(FINER)], axis=0))


def seen(views: Sequence[View], counts: Sequence[IntArray]) -> IntArray:
    """Counts (side, side) of each view, lens frame, added up in the frame of the source that the views share."""
    turned = [np.rot90(of_view, view.quarter_turns) for view, of_view in zip(views, counts, strict=True)]
    return np.asarray(np.sum(turned, axis=0))


def faded(source: FloatArray, counts: IntArray) -> Pixels:
    """(S, S, 3): a source (H, W, C) in linear light, faint where its counts (S, S) are 0."""
    picture = to_pixels(source, len(counts)).astype(np.float32)
    return np.asarray(np.where(counts[..., None] > 0, picture, faint(picture)), np.uint8)


def faint(picture: FloatArray) -> FloatArray:
    """(S, S, 3) display values, 0 to 255: a picture's greys between the two of ``FAINT``."""
    pale: FloatArray = FAINT[0] + picture.mean(axis=-1, keepdims=True) / 255 * (FAINT[1] - FAINT[0])
    return pale
