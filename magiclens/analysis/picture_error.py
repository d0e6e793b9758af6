"""Where the simulated photographs differ from the targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import FloatArray, View
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.photographs import Photograph, photographs
from magiclens.drawing.scales import DIVERGING, ColourScale, Pixels
from magiclens.drawing.tiles import Tile, wrap_tiles
from magiclens.images.colour import luminance, to_display
from magiclens.images.resample import resize

_SIDE = 512
_SCALE = ColourScale(DIVERGING, -1.0, 1.0)


def error_map(renderer: str, photos: Sequence[Photograph], views: Sequence[View], facets: int) -> Figure:
    """One tile per view: display values of the photograph less those of the target, and the grid of facets."""
    tiles = []
    for view, photo in zip(views, photos, strict=True):
        picture = gridded(_SCALE.paint(difference(photo.picture, photo.target, _SIDE)), facets)
        tiles.append(Tile(picture, "", f"{view.name}: {photo.caption}"))
    rows = [[*row[:-1], replace(row[-1], scale=_SCALE)] for row in wrap_tiles(tiles)]
    return Figure(
        "error",
        "Where the picture differs",
        rows,
        f"The photograph of the {renderer} against the target, display values from 0 to 1: "
        "red is too bright, blue too dark, white right; lines are the edges of facets.",
    )


def difference(picture: FloatArray, target: FloatArray, side: int) -> FloatArray:
    """(side, side): display values of a picture less those of its target, both (., ., C) linear light."""
    seen, wanted = (to_display(luminance(resize(image, (side, side)))) for image in (picture, target))
    return np.asarray(seen - wanted)


def gridded(picture: Pixels, facets: int) -> Pixels:
    """The picture (S, S, 3) with thin lines between facets, fainter the closer they are."""
    side = len(picture)
    edges = np.rint(np.arange(1, facets) * side / facets).astype(int)
    line = np.zeros((side, side), bool)
    line[edges] = line[:, edges] = True
    opacity = min(0.16, 0.012 * side / facets)
    return np.where(line[..., None], picture * (1 - opacity), picture).astype(np.uint8)


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    """Of the first renderer; a second one hardly differs from it at this scale."""
    first = list(photographs(result).items())[:1]
    scene = result.scene
    return [error_map(name, photos, scene.views, scene.lens.facets) for name, photos in first]


PICTURE_ERROR = Analysis("error", figures=_figures)
"""Where the simulated photographs differ from the targets."""
