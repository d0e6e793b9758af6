"""Where a universal lens takes each tile of the picture from (the paper's figure 15)."""

from __future__ import annotations

import colorsys

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.analysis.overlap import faint, seeing_facets
from magiclens.contract.artifacts import FloatArray, HeightField, IntArray
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import Pixels
from magiclens.drawing.shading import sample_heights, shade_heights
from magiclens.drawing.tiles import OVERSAMPLING, Tile, mean_of_blocks, to_pixels
from magiclens.geometry.facets import patches_seen
from magiclens.plan.compile import Plan

_SIDE = 480
TINT = 0.55
"""The share of the tint in a tinted picture."""


def warp_map(result: RunResult) -> Figure:
    """The first source and its target, both tinted by facet, and the lens between them."""
    view, lens = result.scene.views[0], result.scene.lens
    local = view.in_lens_frame()
    patches = patches_seen(result.scene, result.assignment, local.eye_mm, result.height_field.levels_mm)
    looking = np.rot90(seeing_facets(lens, patches, OVERSAMPLING * _SIDE), view.quarter_turns)
    facet = np.arange(OVERSAMPLING * _SIDE) * lens.facets // (OVERSAMPLING * _SIDE)
    showing = np.rot90(facet[:, None] * lens.facets + facet, view.quarter_turns)
    colours = facet_colours(lens.facets)
    row = [
        Tile(tinted(view.source, looking, colours), "Source", "patches in the colours of their facets"),
        Tile(tinted(view.target, showing, colours), "What the eye sees", view.name),
        Tile(_cast(result.height_field, view.quarter_turns), "The lens", "in slanting light from the upper left"),
    ]
    return Figure(
        "warp",
        "From the source to the picture",
        [row],
        "Every facet has a colour; in the source the patch that it shows has the same one. Grey is seen by no facet.",
    )


def facet_colours(facets: int) -> FloatArray:
    """(N N, 3) display values: hues around the middle of the lens, paler toward it."""
    at = (np.indices((facets, facets)).reshape(2, -1).T + 0.5) / facets * 2 - 1
    hues, saturations = np.arctan2(at[:, 0], at[:, 1]) / (2 * np.pi) % 1, np.abs(at).max(axis=1)
    pairs = zip(hues.tolist(), saturations.tolist(), strict=True)
    return np.array([colorsys.hsv_to_rgb(hue, 0.25 + 0.75 * saturation, 1.0) for hue, saturation in pairs], np.float32)


def tinted(linear: FloatArray, facets: IntArray, colours: FloatArray) -> Pixels:
    """A picture in the colours of its facets.

    Args:
        linear: (H, W, C) linear light.
        facets: (k S, k S) the facet of each point, -1 for none, which is grey; k is ``OVERSAMPLING``.
        colours: (F, 3) display values, 0 to 1, of the facets.

    Returns:
        (S, S, 3) display values, 0 to 255.
    """
    picture = to_pixels(linear, len(facets)).astype(np.float32)
    washed = picture * (1 - TINT) + 255 * colours[facets] * TINT
    return np.rint(mean_of_blocks(np.where(facets[..., None] < 0, faint(picture), washed))).astype(np.uint8)


def _cast(field: HeightField, turns: int) -> Pixels:
    heights = np.rot90(sample_heights(field, OVERSAMPLING * _SIDE), turns)
    return to_pixels(mean_of_blocks(shade_heights(heights, field.lens.size_mm / len(heights))), _SIDE)


def _applies(plan: Plan) -> bool:
    """Universal lenses; the facets of matched ones see overlapping patches, which cannot all have a colour."""
    return not plan.matcher.stage.uses_pictures


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    return [warp_map(result)]


WARP = Analysis("warp", _applies, figures=_figures)
"""Where a universal lens takes each tile of the picture from."""
