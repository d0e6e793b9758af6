"""The lens as it will be made: its heights, how it looks, and the steps between its facets."""

from __future__ import annotations

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import FloatArray, HeightField
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import DIVERGING, GLOW, ColourScale
from magiclens.drawing.shading import sample_heights, shade_heights
from magiclens.drawing.tiles import OVERSAMPLING, Tile, mean_of_blocks, paint_smoothly, to_pixels
from magiclens.integration.surface_metrics import wall_steps

_SIDE = 640


def height_map(field: HeightField) -> Figure:
    """Heights in colours, and the top in the light."""
    heights = sample_heights(field, OVERSAMPLING * _SIDE)
    scale = ColourScale(DIVERGING, -_reach(heights), _reach(heights))
    extent = f"{field.heights_mm.min():+.2f} to {field.heights_mm.max():+.2f} mm about the reference plane"
    cast = to_pixels(mean_of_blocks(shade_heights(heights, field.lens.size_mm / len(heights))), _SIDE)
    tiles = [
        Tile(paint_smoothly(scale, heights), "Height in mm", extent, scale),
        Tile(cast, "The lens in slanting light", "the lamp is at the upper left"),
    ]
    caption = (
        "The lens seen from above: red stands above the reference plane, blue lies below it; "
        "beside it the same surface as a matt cast in slanting light."
    )
    return Figure("height-map", "The surface", [tiles], caption)


def step_map(field: HeightField) -> Figure:
    """The step across every wall, drawn where the wall is."""
    right, below = wall_steps(field.heights_mm)
    jumps = np.concatenate([right.ravel(), below.ravel()]) if right.size else np.zeros(1)
    scale = ColourScale(GLOW, 0.0, max(float(np.quantile(jumps, 0.995)), 1e-3))
    caption = f"mean {jumps.mean():.3f} mm, highest {jumps.max():.2f} mm"
    picture = paint_smoothly(scale, wall_picture(right, below, OVERSAMPLING * _SIDE))
    tile = Tile(picture, "Step across each wall in mm", caption, scale)
    return Figure(
        "steps",
        "Steps between facets",
        [[tile]],
        "Every line is a wall between two facets, the brighter the higher: dark stretches are where neighbours meet.",
    )


def wall_picture(right: FloatArray, below: FloatArray, side: int) -> FloatArray:
    """(side, side) mm: steps across walls (as of ``measures.steps``) on lines along the walls, 0 between them."""
    n, points = right.shape[0], right.shape[2]
    at = (np.arange(side) + 0.5) / side * n
    facet, nearest = at.astype(int), np.rint(at).astype(int)
    on_wall = (abs(at - nearest) < 0.11) & (nearest > 0) & (nearest < n)
    along = np.minimum(((at - facet) * points).astype(int), points - 1)
    out = np.zeros((side, side))
    across = np.flatnonzero(on_wall)
    if len(across):
        out[:, across] = right[facet[:, None], nearest[None, across] - 1, along[:, None]]
        out[across] = np.maximum(out[across], below[nearest[across, None] - 1, facet[None], along[None]])
    return out


def _reach(heights: FloatArray) -> float:
    """The largest distance of heights from the reference plane, mm; at least 1 um, so that a scale has an extent."""
    return max(float(np.abs(heights).max()), 1e-3)


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    return [height_map(result.height_field), step_map(result.height_field)]


SURFACE = Analysis("surface", figures=_figures)
"""The heights of the lens, and the steps between its facets."""
