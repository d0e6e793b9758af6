"""The built-in renderer: rays through the top's regular grid, one path per sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from pydantic import Field

from magiclens.contract.artifacts import FloatArray, Lens, Scene, Solid, View
from magiclens.contract.stages import Progress, Renderer, silent
from magiclens.kernels.spreading import shares, spread

_MOST_PIXELS = 2**20
"""Pixels whose samples are traced before they are averaged, about: with 16 samples each, these need 200 MB."""


class Tracer(Renderer):
    """Height-field ray tracing of the finished solid: fast, noise-free, with Fresnel losses and shadowing by walls."""

    type: ClassVar[str] = "tracer"

    resolution: int = Field(512, ge=16, le=4096, description="pixels per side of the picture")
    samples: int = Field(4, ge=1, le=16, description="samples per side of a pixel")

    def render(self, scene: Scene, solid: Solid, progress: Progress = silent) -> list[FloatArray]:
        """See Renderer. Raises InputError if the solid is no longer a height field."""
        eyes: dict[tuple[float, ...], list[int]] = {}  # frames of an animation share one
        for number, view in enumerate(scene.views):
            eyes.setdefault(tuple(view.eye_in_lens_frame_mm.tolist()), []).append(number)
        side = self.resolution
        items = [(numbers, rows) for numbers in eyes.values() for rows in shares(side, most=_MOST_PIXELS // side)]
        pictures = [np.empty((side, side, view.source.shape[2]), np.float32) for view in scene.views]
        for done, seen in spread(_picture_rows, (self, scene, solid), items):
            numbers, rows = items[done]
            for number, part in zip(numbers, seen, strict=True):
                pictures[number][rows.start : rows.stop] = part
            progress((done + 1) / len(items))
        turned = zip(pictures, scene.views, strict=True)
        return [np.ascontiguousarray(np.rot90(picture, view.quarter_turns)) for picture, view in turned]


def _picture_rows(given: tuple[Tracer, Scene, Solid], item: tuple[Sequence[int], range]) -> list[FloatArray]:
    """Some rows of the pictures of views that share an eye, by the numbers of the views; lens frame."""
    (tracer, scene, solid), (numbers, rows) = given, item
    views, ends = [scene.views[number] for number in numbers], (rows.start, rows.stop)
    hits = trace(solid, scene.lens, views[0], tracer.resolution, tracer.samples, ends)
    return [picture(hits, view.in_lens_frame().source, scene.lens.source_size_mm) for view in views]


def trace(
    solid: Solid, lens: Lens, view: View, resolution: int, samples: int, rows: tuple[int, int] | None = None
) -> FloatArray:
    """What every sample of a picture shows to the eye of a view, and how strongly.

    The picture is the lens's square on the reference plane as the eye sees it. Samples lie on a turned grid, no two of
    a pixel in one row or column, so that a facet's narrow upright and level strips are seen in proportion even where
    whole pixels fit a facet.

    Args:
        solid: with the top's regular grid.
        lens: the lens that the solid was made for.
        view: its eye is used; the source and the target are not.
        resolution: R, pixels along the picture's side.
        samples: S, samples along a pixel's side.
        rows: the first of the picture's rows that are wanted, and the one after the last; all by default.

    Returns:
        (rows, R, S * S, 3) float32, lens frame: source point x, y (mm, +y up) and transmission, which is 0 where light
        is lost.

    Raises:
        InputError: a finisher has removed the grid.
    """
    from magiclens.optics.medium import slab_of
    from magiclens.rendering.grid import grid_of
    from magiclens.rendering.tracer_kernels import PictureRows, trace_rows

    eye = np.ascontiguousarray(view.eye_in_lens_frame_mm)
    wanted = PictureRows(lens.size_mm, resolution, samples, *(rows or (0, resolution)))
    hits: FloatArray = trace_rows(grid_of(solid, lens), slab_of(lens), eye, wanted)
    return hits


def picture(hits: FloatArray, source: FloatArray, source_size_mm: float) -> FloatArray:
    """The traced view of a source, by bilinear look-up.

    Args:
        hits: (rows, R, S * S, 3), as of ``trace``.
        source: (H, W, C) linear light, in the lens frame.
        source_size_mm: side of the square that the source covers.

    Returns:
        (rows, R, C) float32, linear light, in the lens frame.
    """
    from magiclens.rendering.source_kernels import average_samples

    per_mm = source.shape[1] / source_size_mm
    seen: FloatArray = average_samples(hits, np.ascontiguousarray(source, np.float32), per_mm)
    return seen
