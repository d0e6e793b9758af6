"""What annealing does to the surface and to the picture (the paper's figure 4)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.analysis.ideal_picture import predict_view
from magiclens.contract.artifacts import Assignment, FloatArray, Scene
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import photograph
from magiclens.drawing.scales import Pixels
from magiclens.drawing.shading import shade_slopes
from magiclens.drawing.tiles import Tile, to_pixels
from magiclens.geometry.facets import central_slopes

_SIDE = 480


def before_after(result: RunResult) -> Figure:
    """Surface and ideal picture: of every facet's best candidate, and of the annealed choice."""
    energies = result.manifest["metrics"]
    surfaces, pictures = [], []
    before = ("before", result.best_match, result.candidates.heights_mm)
    after = ("after", result.assignment, result.height_field.levels_mm)
    for when, assignment, heights in (before, after):
        energy = energies.get(f"energy_{when}")
        caption = "" if energy is None else f"energy {energy:.4g}"
        surfaces.append(Tile(surface(result.scene, assignment), f"Surface {when} annealing", caption))
        pictures.append(_prediction(result.scene, assignment, heights))
    return Figure(
        "annealing",
        "Before and after annealing",
        [surfaces, pictures],
        "Left, every facet shows the patch that looks best, whatever its neighbours do; right, after annealing, "
        "neighbours fit together. Below is what perfect facets would show in the first view.",
    )


def surface(scene: Scene, assignment: Assignment) -> Pixels:
    """(_SIDE, _SIDE, 3): the slopes that an assignment asks for, in the light; no integration, so no steps."""
    slopes = fine_slopes(scene, assignment, math.ceil(_SIDE / scene.lens.facets))
    return to_pixels(shade_slopes(slopes), _SIDE)


def fine_slopes(scene: Scene, assignment: Assignment, parts: int) -> FloatArray:
    """(N parts, N parts, 2) dz/dx, dz/dy of ideal lenslets, row 0 at +y.

    A part at p from its facet's centre shows what a facet of its own size with the offset ``offset + (M - 1) p`` would.
    """
    lens = scene.lens
    at = ((np.arange(parts) + 0.5) / parts - 0.5) * lens.pitch_mm
    x, y = at[None, None, None, :], -at[None, :, None, None]
    xx, xy, yy = (np.moveaxis(assignment.maps, -1, 0)[:, :, None, :, None]).astype(float)
    ox, oy = (np.moveaxis(assignment.offsets_mm, -1, 0)[:, :, None, :, None]).astype(float)
    offsets = np.stack([ox + (xx - 1) * x + xy * y, oy + xy * x + (yy - 1) * y], axis=-1)
    n = lens.facets * parts
    finer = replace(scene, lens=replace(lens, facets=n))
    return central_slopes(finer, offsets.reshape(n, n, 1, 2))[:, :, 0]


def _prediction(scene: Scene, assignment: Assignment, heights_mm: FloatArray | None) -> Tile:
    """The first view's picture under perfect facets that stand at these heights (N, N)."""
    first = scene.views[0]
    photo = photograph(predict_view(scene, assignment, first, _SIDE, heights_mm=heights_mm), first)
    return Tile(to_pixels(photo.picture, _SIDE), "What it would show", f"{first.name}: {photo.caption}")


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    return [before_after(result)]


ANNEALING_EFFECT = Analysis("annealing", figures=_figures)
"""What annealing does to the surface and to the ideal picture."""
