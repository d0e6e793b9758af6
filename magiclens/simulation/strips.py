"""What the eyes see of a milled lens. Its surface is too fine to be held in one piece, so it is traced in strips."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Scene, Solid
from magiclens.milling.border import outer, top_of
from magiclens.rendering.tracer import Tracer, picture, trace

Surface = Callable[[FloatArray, FloatArray], Sequence[FloatArray]]
"""From x (columns,) ascending and y (rows,) descending, lens frame, to heights (rows, columns) there, a raster for each
state in which the lens is to be seen, mm."""

STRIP_POINTS = 24_000_000
MARGIN_MM = 0.5
"""Beside what the eyes see of a strip, lest light that bends or is reflected away leave it at once."""


def points_of(solid: Solid, pixel_mm: tuple[float, float]) -> float:
    """How many points a raster of this pitch along x and y has over a solid's top."""
    x0, x1, y0, y1 = outer(solid)
    return (x1 - x0) / pixel_mm[0] * (y1 - y0) / pixel_mm[1]


def seen_in_strips(
    scene: Scene, design: Solid, surface: Surface, pixel_mm: tuple[float, float], tracer: Tracer | None = None
) -> list[list[FloatArray]]:
    """Per state and view (R, R, C) float32, linear light, world frame, as the tracer renders it.

    The lens has the design's outline and another top: ``surface``, sampled with this pitch along x and y.
    """
    tracer, lens, top = tracer or Tracer(), scene.lens, top_of(design)
    x0, x1, y0, y1 = outer(design)
    x = np.arange(x0, x1, pixel_mm[0])
    floor = design.vertices[top[..., 0].size :]
    views = {tuple(view.eye_in_lens_frame_mm.tolist()): view for view in scene.views}
    low, high = float(top[..., 2].min()) - MARGIN_MM, float(top[..., 2].max())
    count = math.ceil(points_of(design, pixel_mm) / STRIP_POINTS)
    hits: dict[tuple[int, tuple[float, ...]], list[FloatArray]] = {}
    for rows in np.array_split(np.arange(tracer.resolution), count):
        first, end = int(rows[0]), int(rows[-1]) + 1
        down, up = _span(lens.size_mm, tracer.resolution, (first, end), list(views), lens.thickness_mm, (low, high))
        steps = np.arange(max(math.floor((down - y0) / pixel_mm[1]), 0), math.ceil((min(up, y1) - y0) / pixel_mm[1]))
        y = np.ascontiguousarray(y0 + pixel_mm[1] * steps[::-1])
        for state, z in enumerate(surface(x, y)):
            solid = topped(x, y, z, floor)
            for eye, view in views.items():
                part = trace(solid, lens, view, tracer.resolution, tracer.samples, (first, end))
                hits.setdefault((state, eye), []).append(part)
    whole = {key: np.concatenate(parts) for key, parts in hits.items()}
    pictures: list[list[FloatArray]] = []
    for state in range(len(hits) // len(views)):
        pictures.append([])
        for view in scene.views:
            turned = view.in_lens_frame()
            seen = picture(whole[state, tuple(turned.eye_mm.tolist())], turned.source, lens.source_size_mm)
            pictures[-1].append(np.ascontiguousarray(np.rot90(seen, view.quarter_turns)))
    return pictures


def _span(
    size_mm: float, resolution: int, rows: tuple[int, int], eyes: Sequence[tuple[float, ...]], plane_mm: float,
    heights_mm: tuple[float, float],
) -> tuple[float, float]:  # fmt: skip
    """Between which y eyes see the surface, which lies between two heights, in rows of their pictures."""
    at = []
    for _, y, z in eyes:
        for row in rows:
            on_plane = (0.5 - row / resolution) * size_mm
            at += [y + (on_plane - y) * (z - height) / (z - plane_mm) for height in heights_mm]
    return min(at) - MARGIN_MM, max(at) + MARGIN_MM


def topped(x: FloatArray, y: FloatArray, z: FloatArray, floor: FloatArray) -> Solid:
    """As much of a body as the tracer asks for: a top with vertical cells, and points that span the floor; no faces."""
    top = np.stack([*np.meshgrid(x, y), z], axis=-1).reshape(-1, 3)
    nothing: IntArray = np.zeros((0, 3), np.int32)
    return Solid(np.concatenate([top, floor]), nothing, (len(y), len(x)), None)
