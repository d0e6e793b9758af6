"""How many facets see each point of the source (the paper's figure 7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import Assignment, FloatArray, IntArray, Lens, Scene, View
from magiclens.contract.errors import InputError
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import BLUE_TO_RED, ColourScale, Pixels
from magiclens.drawing.tiles import Tile, to_pixels, wrap_tiles
from magiclens.geometry.facets import Patches, patches_seen
from magiclens.plan.compile import Plan
from magiclens.plan.registry import STAGE

_SIDE = 480
FAINT = np.array([[132, 150, 176], [186, 200, 220]], np.float32)
"""Black and white of a faint picture, display values 0 to 255."""
COUNTS_PER_PIXEL = 4
"""Patches are counted at this multiple of the figure's resolution: many are narrower than its pixels."""


def overlap_map(result: RunResult, matched: Assignment | None) -> Figure:
    """The heat map in the lens frame, and every source with what no facet sees faded.

    Args:
        result: The run.
        matched: What a matched lens would show of the first source, for a second heat map; None leaves that out.
    """
    views, levels = result.scene.views, result.height_field.levels_mm
    eyes = [tuple(view.eye_in_lens_frame_mm.round(6)) for view in views]
    seen_by = {eye: patches_seen(result.scene, result.assignment, np.array(eye), levels) for eye in eyes}
    each = {eye: overlaps(result.scene.lens, patches, COUNTS_PER_PIXEL * _SIDE) for eye, patches in seen_by.items()}
    fine = np.asarray(np.sum(list(each.values()), axis=0))
    counts = coarse(fine)
    most = np.quantile(counts[counts > 0], 0.999, method="nearest") if counts.any() else 1
    scale = ColourScale(BLUE_TO_RED, 0.0, float(most), whole=True)
    together = f" for {len(each)} eyes" if len(each) > 1 else ""
    caption = f"at most {counts.max()}{together}; {np.mean(fine > 0):.0%} of the source is seen"
    tiles = [Tile(scale.paint(counts), "How many facets see each point", caption, scale)]
    if matched:
        tiles.append(_matched_tile(result.scene, matched))
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


def _matched_tile(scene: Scene, matched: Assignment) -> Tile:
    """The heat map of a lens whose facets may look anywhere, on a scale of its own, as it sees much more often."""
    patches = patches_seen(scene, matched, scene.views[0].eye_in_lens_frame_mm)
    fine = overlaps(scene.lens, patches, COUNTS_PER_PIXEL * _SIDE)
    counts = coarse(fine)
    scale = ColourScale(BLUE_TO_RED, 0.0, float(counts.max()), whole=True)
    caption = f"at most {counts.max()}; {np.mean(fine > 0):.0%} of the source is seen"
    return Tile(scale.paint(counts), "A lens matched to the first source", caption, scale)


def overlaps(lens: Lens, patches: Patches, side: int) -> IntArray:
    """(side, side) int32, lens frame, row 0 at +y: through how many facets the centre of each source pixel is seen."""
    return _counted(lens, patches, side)[0]


def seeing_facets(lens: Lens, patches: Patches, side: int) -> IntArray:
    """(side, side) int32, as ``overlaps``: the facet that sees each source pixel, as row * N + column, or -1.

    Where several facets do, it is the last of them.
    """
    return _counted(lens, patches, side)[1]


def _counted(lens: Lens, patches: Patches, side: int) -> tuple[IntArray, IntArray]:
    landings, maps = patches.landings_mm.reshape(-1, 2), np.ascontiguousarray(patches.maps.reshape(-1, 4))
    from magiclens.analysis.overlap_kernels import count_overlaps

    counts, last = count_overlaps(landings, maps, lens.pitch_mm / 2, lens.source_size_mm, side)
    return counts, last


def coarse(counts: IntArray) -> IntArray:
    """(S, S) from (COUNTS_PER_PIXEL S, COUNTS_PER_PIXEL S): the most in each block, so that no patch is lost."""
    rows = np.max([counts[k::COUNTS_PER_PIXEL] for k in range(COUNTS_PER_PIXEL)], axis=0)
    return np.asarray(np.max([rows[:, k::COUNTS_PER_PIXEL] for k in range(COUNTS_PER_PIXEL)], axis=0))


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


def matched_lens(plan: Plan, scene: Scene) -> Assignment | None:
    """Every facet at its best patch of the first source, as the ``exhaustive`` matcher finds it with its usual options.

    Returns:
        None if that matcher is not installed, or finds no patch for some facet.
    """
    found = plan.registry.find(STAGE, "matcher", "exhaustive")
    if found is None:
        return None
    try:
        candidates = found[0]().match(replace(scene, views=scene.views[:1]), np.random.default_rng(0))
    except InputError:
        return None
    return Assignment.pick(candidates, candidates.errors.argmin(axis=-1))


def _compute(plan: Plan, result: RunResult) -> Findings:
    """A universal lens is compared with a matched one: that is how much more often facets would overlap."""
    universal = not plan.matcher.stage.uses_pictures
    return Findings(details=matched_lens(plan, result.painted) if universal else None)


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    return [overlap_map(result, findings.details)]


OVERLAP = Analysis("overlap", compute=_compute, figures=_figures)
"""How many facets see each point of the sources."""
