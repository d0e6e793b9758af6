"""A scene's facets before they are built: their edges and slopes, what eyes see through them, what lost light costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import Assignment, FloatArray, Scene
from magiclens.images import to_display
from magiclens.kernels.threads import side_by_side

if TYPE_CHECKING:
    from magiclens.optics.walls import Edges

EDGE_POINTS = 4
"""Q, the number of points per facet edge at which steps are measured."""


def edge_models(scene: Scene, offsets: FloatArray, maps: FloatArray) -> Edges:
    """The edges of the lenslets that candidates ask for, to second order, see ``optics.walls``.

    Args:
        scene: the lens and its views.
        offsets: (N, N, K, 2) of the candidates, mm, +y up.
        maps: (N, N, K, 3) of the candidates, as (xx, xy, yy).

    Returns:
        Profiles, mm, of lenslets of zero mean, and outward drifts, both (N, N, K, 4, Q) float32.
    """
    from magiclens.optics.lenslets import lenslet_edges
    from magiclens.optics.medium import cut_of, slab_of
    from magiclens.optics.walls import Edges

    lens, n = scene.lens, scene.lens.facets
    edges = lenslet_edges(
        lens.facet_centres_mm().reshape(-1, 2), *_flat(n, offsets, maps), lens.pitch_mm,
        cut_of(scene), _eyes(scene), slab_of(lens), EDGE_POINTS,
    )  # fmt: skip
    shape = *offsets.shape[:3], 4, EDGE_POINTS
    return Edges(edges.profiles.reshape(shape), edges.drifts.reshape(shape))


def built_drifts(scene: Scene, shapes: FloatArray) -> FloatArray:
    """(N, N, 4, k) float32 outward drifts at the edges of facets of shapes (N, N, k, k), mm, see ``optics.walls``."""
    from magiclens.optics.lenslets import shape_drifts
    from magiclens.optics.medium import cut_of, slab_of

    lens, n, k = scene.lens, scene.lens.facets, shapes.shape[2]
    drifts: FloatArray = shape_drifts(
        np.ascontiguousarray(shapes.reshape(-1, k, k)), lens.facet_centres_mm().reshape(-1, 2),
        (lens.pitch_mm - lens.wall_mm) / (k - 1), cut_of(scene), _eyes(scene), slab_of(lens),
    )  # fmt: skip
    return drifts.reshape(n, n, 4, k)


def central_slopes(scene: Scene, offsets: FloatArray) -> FloatArray:
    """The slopes that facets need at their centres to show patches to the reference eye (4.3).

    Args:
        scene: the lens and its views.
        offsets: (N, N, K, 2) from the facets' centres to the patches' centres, mm, lens frame, +y up.

    Returns:
        (N, N, K, 2) float64 dz/dx and dz/dy.
    """
    from magiclens.optics.lenslets import centre_slopes
    from magiclens.optics.medium import slab_of

    lens, n = scene.lens, scene.lens.facets
    flat = offsets.reshape(n * n, -1, 2).astype(np.float64)
    slopes: FloatArray = centre_slopes(
        lens.facet_centres_mm().reshape(-1, 2), flat, scene.reference_eye_mm, slab_of(lens)
    )
    return slopes.reshape(offsets.shape)


@dataclass(frozen=True)
class Patches:
    """What an eye sees through the facets, to first order: ``landing + map p`` at ``position + shear p``.

    p is where on the facet a point is as the reference eye sees it, from the facet's centre, mm, +y up.

    Args:
        landings_mm: (N, N, 2) source points seen at the facets' centres; nan where light is reflected totally.
        maps: (N, N, 2, 2).
        positions_mm: (N, N, 2) where on the reference plane the eye sees the facets' centres.
        shears: (N, N, 2, 2).
    """

    landings_mm: FloatArray
    maps: FloatArray
    positions_mm: FloatArray
    shears: FloatArray


def patches_seen(
    scene: Scene, assignment: Assignment, eye_mm: FloatArray, heights_mm: FloatArray | None = None
) -> Patches:
    """What an eye sees if facets show the reference eye exactly what an assignment asks for (4.6).

    Args:
        scene: the lens and its views.
        assignment: what the facets show the reference eye.
        eye_mm: (3,) lens frame. The reference eye sees the assignment's own offsets and maps.
        heights_mm: (N, N) levels of the facets above the reference plane; None is the plane itself.
    """
    lens, n, cut_eye = scene.lens, scene.lens.facets, scene.reference_eye_mm
    centres = lens.facet_centres_mm()
    xx, xy, yy = np.moveaxis(assignment.maps.astype(np.float64), -1, 0)
    given = np.stack([xx, xy, xy, yy], axis=-1).reshape(n, n, 2, 2)
    if np.allclose(eye_mm, cut_eye, rtol=0, atol=1e-6):
        return Patches(centres + assignment.offsets_mm, given, centres, np.broadcast_to(np.eye(2), given.shape))
    from magiclens.optics.eyes import linearised
    from magiclens.optics.medium import slab_of

    offsets = assignment.offsets_mm.reshape(-1, 2).astype(np.float64)
    heights = np.zeros(n * n) if heights_mm is None else np.array(heights_mm, np.float64).ravel()
    # a copy: kernels are compiled again for arrays that may not be written to
    seen = linearised(np.array(eye_mm), cut_eye, centres.reshape(-1, 2), heights, offsets, slab_of(lens))
    landings, positions = seen.landing.reshape(n, n, 2), seen.position.reshape(n, n, 2)
    along, span, shears = (
        a.reshape(n, n, 2, 2) for a in (seen.by_facet, seen.by_source, seen.position_by_facet)
    )  # fmt: skip
    return Patches(landings, along + span @ given, positions, shears)


def cost_of_lost_light(scene: Scene) -> float:
    """Mean squared difference, in display values, of a target pixel and a random pixel of the source."""
    different = {view.source_name: view.source for view in scene.views}
    sources = dict(zip(different, side_by_side(_moments, different.values()), strict=True))
    targets = side_by_side(_moments, [view.target for view in scene.views])
    total = 0.0
    for view, (mean, square) in zip(scene.views, targets, strict=True):
        seen_mean, seen_square = sources[view.source_name]
        total += float(seen_square - 2 * seen_mean * mean + square)
    return total / len(scene.views)


def _moments(linear: FloatArray) -> tuple[np.float32, np.float32]:
    """Mean and mean square of a picture's display values."""
    shown = to_display(linear)
    return shown.mean(), (shown**2).mean()


def _eyes(scene: Scene) -> FloatArray:
    """(V, 3) the different eyes of all views, lens frame, mm."""
    eyes: FloatArray = np.unique(np.stack([view.eye_in_lens_frame_mm for view in scene.views]).round(9), axis=0)
    return eyes


def _flat(n: int, offsets: FloatArray, maps: FloatArray) -> tuple[FloatArray, FloatArray]:
    return offsets.reshape(n * n, -1, 2).astype(np.float64), maps.reshape(n * n, -1, 3).astype(np.float64)
