"""Where a universal lens takes each tile of the picture from (the paper's figure 15)."""

from __future__ import annotations

import colorsys

import numpy as np

from magiclens.analysis.overlap import facets_that_look, faint
from magiclens.contract.artifacts import FloatArray, HeightField, IntArray
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import Pixels
from magiclens.drawing.shading import sample_heights, shade_heights
from magiclens.drawing.tiles import OVERSAMPLING, Tile, mean_of_blocks, to_pixels
from magiclens.geometry.facets import patches_seen

SIDE = 480
INK = 0.55
"""How much of a tinted picture is its tint."""


def warp_map(data: RunResult) -> Figure:
    """The first source and its target, both tinted by facet, and the lens between them."""
    view, lens = data.scene.views[0], data.scene.lens
    local = view.in_lens_frame()
    patches = patches_seen(data.scene, data.assignment, local.eye_mm, data.height_field.levels_mm)
    looking = np.rot90(facets_that_look(lens, patches, OVERSAMPLING * SIDE), view.quarter_turns)
    facet = np.arange(OVERSAMPLING * SIDE) * lens.facets // (OVERSAMPLING * SIDE)
    showing = np.rot90(facet[:, None] * lens.facets + facet, view.quarter_turns)
    colours = facet_colours(lens.facets)
    row = [
        Tile(tinted(view.source, looking, colours), "Source", "patches in the colours of their facets"),
        Tile(tinted(view.target, showing, colours), "What the eye sees", view.name),
        Tile(_cast(data.height_field, view.quarter_turns), "The lens", "in slanting light from the upper left"),
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
    hues, strength = np.arctan2(at[:, 0], at[:, 1]) / (2 * np.pi) % 1, np.abs(at).max(axis=1)
    pairs = zip(hues.tolist(), strength.tolist(), strict=True)
    return np.array([colorsys.hsv_to_rgb(hue, 0.25 + 0.75 * s, 1.0) for hue, s in pairs], np.float32)


def tinted(linear: FloatArray, facets: IntArray, colours: FloatArray) -> Pixels:
    """(S, S, 3): a picture (H, W, C), linear light, in the colours (F, 3) of facets (2 S, 2 S); grey at -1."""
    picture = to_pixels(linear, len(facets)).astype(np.float32)
    washed = picture * (1 - INK) + 255 * colours[facets] * INK
    return np.rint(mean_of_blocks(np.where(facets[..., None] < 0, faint(picture), washed))).astype(np.uint8)


def _cast(field: HeightField, turns: int) -> Pixels:
    heights = np.rot90(sample_heights(field, OVERSAMPLING * SIDE), turns)
    return to_pixels(mean_of_blocks(shade_heights(heights, field.lens.size_mm / len(heights))), SIDE)
