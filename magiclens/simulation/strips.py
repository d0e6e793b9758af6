"""What eyes see of a milled lens, whose surface is too fine to be held in one piece: it is traced in strips."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray, Scene, Solid
from magiclens.milling.border import outer_rectangle, top_vertices
from magiclens.rendering.tracer import Tracer, picture, trace

SurfaceSampler = Callable[[FloatArray, FloatArray], Sequence[FloatArray]]
"""From x (columns,) ascending and y (rows,) descending, lens frame, to heights (rows, columns) there, a raster for each
state in which the lens is to be seen, mm."""

STRIP_POINTS = 24_000_000
"""Most points of a strip, unless a caller wants fewer."""
_MARGIN_MM = 0.5
"""Width beside what eyes see of a strip, so that light that bends or is reflected does not leave the strip at once."""


def points_of(solid: Solid, pixel_mm: tuple[float, float]) -> float:
    """How many points a raster of this pitch along x and along y has over a solid's top."""
    x0, x1, y0, y1 = outer_rectangle(solid)
    return (x1 - x0) / pixel_mm[0] * (y1 - y0) / pixel_mm[1]


def seen_in_strips(
    scene: Scene, design: Solid, surface: SurfaceSampler, pixel_mm: tuple[float, float],
    tracer: Tracer | None = None, strip_points: int = STRIP_POINTS,
) -> list[list[FloatArray]]:  # fmt: skip
    """What eyes see of a lens that has the design's outline and another top.

    Args:
        scene: the views.
        design: a solid with a grid, lens frame.
        surface: samples the other top, in one or several states.
        pixel_mm: distance of its samples along x and along y.
        tracer: whose resolution and samples count; the default one if left out.
        strip_points: most samples that are held at once.

    Returns:
        Per state and view (R, R, C) float32, linear light, world frame, as the tracer renders it.
    """
    tracer, lens, top = tracer or Tracer(), scene.lens, top_vertices(design)
    x0, x1, y0, y1 = outer_rectangle(design)
    x = np.arange(x0, x1, pixel_mm[0])
    floor = design.vertices[top[..., 0].size :]
    views = {tuple(view.eye_in_lens_frame_mm.tolist()): view for view in scene.views}
    low, high = float(top[..., 2].min()) - _MARGIN_MM, float(top[..., 2].max())
    count = math.ceil(points_of(design, pixel_mm) / strip_points)
    hits: dict[tuple[int, tuple[float, ...]], list[FloatArray]] = {}
    for rows in np.array_split(np.arange(tracer.resolution), count):
        first, end = int(rows[0]), int(rows[-1]) + 1
        down, up = _span(lens.size_mm, tracer.resolution, (first, end), list(views), lens.thickness_mm, (low, high))
        steps = np.arange(max(math.floor((down - y0) / pixel_mm[1]), 0), math.ceil((min(up, y1) - y0) / pixel_mm[1]))
        y = np.ascontiguousarray(y0 + pixel_mm[1] * steps[::-1])
        for state, z in enumerate(surface(x, y)):
            solid = traceable(x, y, z, floor)
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
    """The lowest and the highest y, lens frame, mm, that eyes see in some rows of their pictures.

    Args:
        size_mm, plane_mm: side of the lens and z of the reference plane, which the pictures cover.
        resolution: number of rows of a picture.
        rows: first row, and the row after the last.
        eyes: (x, y, z) of each, lens frame.
        heights_mm: lowest and highest z of the surface.
    """
    at = []
    for _, y, z in eyes:
        for row in rows:
            on_plane = (0.5 - row / resolution) * size_mm
            at += [y + (on_plane - y) * (z - height) / (z - plane_mm) for height in heights_mm]
    return min(at) - _MARGIN_MM, max(at) + _MARGIN_MM


def traceable(x: FloatArray, y: FloatArray, z: FloatArray, floor: FloatArray) -> Solid:
    """As much of a body as the tracer asks for: a top with vertical cells and points that span the floor, no faces.

    Args:
        x: (columns,) ascending, mm.
        y: (rows,) descending.
        z: (rows, columns).
        floor: (V, 3) vertices of the bottom.
    """
    top = np.stack([*np.meshgrid(x, y), z], axis=-1).reshape(-1, 3)
    nothing: IntArray = np.zeros((0, 3), np.int32)
    return Solid(np.concatenate([top, floor]), nothing, (len(y), len(x)), None)
