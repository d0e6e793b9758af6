"""One look at all triangles of an exported top, some at a time, so that a mesh of any size needs little memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, View
from magiclens.kernels.threads import side_by_side_ahead
from magiclens.preflight.light import SeenTop, seen_top
from magiclens.preflight.mesh_file import MeshFile, mirrored_triangles
from magiclens.preflight.picture import CHECKED_VIEWS, light_in_pixels, picture_of_light
from magiclens.preflight.triangles import TopTriangles, top_triangles, trace_triangles

if TYPE_CHECKING:
    from magiclens.preflight.triangles_kernels import TracedTriangles


@dataclass(frozen=True)
class Survey:
    """What the top of a mesh file is like, and what the views' eyes see of it.

    Attributes:
        top: Its triangles.
        seen: The same as eyes see them.
        areas_mm2: (E, 3), see ``seen_top``.
        pictures: (S, S, C) float32, linear light, of the views that are checked.
        flipped_pictures: The same through the mirrored body. It is no mirror image, since the source stays.
    """

    top: TopTriangles
    seen: SeenTop
    areas_mm2: FloatArray
    pictures: list[FloatArray]
    flipped_pictures: list[FloatArray]


def survey(file: MeshFile, lens: Lens, eye_mm: FloatArray | None, views: Sequence[View]) -> Survey:
    """Look at the top of a mesh file.

    Args:
        file: The mesh file.
        lens: The lens that it should hold.
        eye_mm: (3,) eye along whose rays the facets are cut, lens frame; None for vertical cells.
        views: All views, in the lens frame.
    """
    tops: list[TopTriangles] = []
    seens: list[SeenTop] = []
    sums: list[FloatArray] = []
    for top, seen, *more in side_by_side_ahead(partial(_look, lens, eye_mm, views), file.top_parts(lens)):
        tops.append(top)
        seens.append(seen)
        sums = [old + new for old, new in zip(sums, more, strict=True)] if sums else more
    columns = [[np.concatenate(parts) for parts in zip(*tables, strict=True)] for tables in (tops, seens)]
    areas, *pictures = sums[0], *([picture_of_light(light) for light in lights] for lights in sums[1:])
    return Survey(TopTriangles(*columns[0]), SeenTop(*columns[1]), areas, *pictures)


def _look(
    lens: Lens, eye_mm: FloatArray | None, views: Sequence[View], triangles: FloatArray
) -> tuple[TopTriangles, SeenTop, FloatArray, FloatArray, FloatArray]:
    """What ``Survey`` tells of some triangles; light in pixels in place of pictures."""
    top = top_triangles(triangles, lens, eye_mm)
    traced = _traced(triangles, lens, views)
    seen, areas = seen_top(top.wall, list(traced.values()))
    shown = views[:CHECKED_VIEWS]
    flipped = _traced(mirrored_triangles(triangles), lens, shown)
    light, flipped_light = (
        np.array([light_in_pixels(each[view.eye_mm.tobytes()], lens, view) for view in shown])
        for each in (traced, flipped)
    )
    return top, seen, areas, light, flipped_light


def _traced(triangles: FloatArray, lens: Lens, views: Sequence[View]) -> dict[bytes, TracedTriangles]:
    """What each different eye of the views sees of triangles, by the eye."""
    eyes = {view.eye_mm.tobytes(): view.eye_mm for view in views}
    return {key: trace_triangles(triangles, lens, eye) for key, eye in eyes.items()}
