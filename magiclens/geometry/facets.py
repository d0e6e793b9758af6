"""A scene's facets before they are built: what candidates would need of the surface, and what lost light costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import Assignment, FloatArray, Scene
from magiclens.images import to_display

if TYPE_CHECKING:
    from magiclens.optics.walls import Edges

EDGE_POINTS = 4
"""Points per facet edge at which steps are measured."""


def edge_models(scene: Scene, offsets: FloatArray, maps: FloatArray) -> Edges:
    """Edge profiles, mm, of zero-mean lenslets, and outward drifts, both (N, N, K, 4, Q) float32.

    offsets: (N, N, K, 2) mm and maps: (N, N, K, 3), as in ``artifacts.Candidates``. See ``optics.walls``.
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
    """Outward drifts (N, N, 4, k) float32 at the edges of facets of shapes (N, N, k, k), mm. See ``optics.walls``."""
    from magiclens.optics.lenslets import shape_drifts
    from magiclens.optics.medium import cut_of, slab_of

    lens, n, k = scene.lens, scene.lens.facets, shapes.shape[2]
    drifts: FloatArray = shape_drifts(
        np.ascontiguousarray(shapes.reshape(-1, k, k)), lens.facet_centres_mm().reshape(-1, 2),
        (lens.pitch_mm - lens.wall_mm) / (k - 1), cut_of(scene), _eyes(scene), slab_of(lens),
    )  # fmt: skip
    return drifts.reshape(n, n, 4, k)


def central_slopes(scene: Scene, offsets: FloatArray) -> FloatArray:
    """(N, N, K, 2) dz/dx and dz/dy at the facets' centres that show the patches at ``offsets`` (N, N, K, 2) mm."""
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
    """What an eye sees through the facets, to first order: ``landing + map p`` at ``place + shear p`` in its picture.

    p is a point's place on the facet as the reference eye sees it, from the facet's centre, mm, +y up. landings_mm:
    (N, N, 2), nan where light is reflected totally; places_mm: (N, N, 2); maps, shears: (N, N, 2, 2).
    """

    landings_mm: FloatArray
    maps: FloatArray
    places_mm: FloatArray
    shears: FloatArray


def patches_seen(
    scene: Scene, assignment: Assignment, eye_mm: FloatArray, heights_mm: FloatArray | None = None
) -> Patches:
    """What an eye (3,), lens frame, sees if facets realise an assignment exactly (4.6).

    heights_mm: (N, N), where the facets stand; None is the reference plane. For the reference eye that does not matter:
    it sees the assignment's own offsets and maps.
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
    heights = np.zeros(n * n) if heights_mm is None else np.ascontiguousarray(heights_mm, np.float64).ravel()
    seen = linearised(eye_mm, cut_eye, centres.reshape(-1, 2), heights, offsets, slab_of(lens))
    landings, places = seen.landing.reshape(n, n, 2), seen.position.reshape(n, n, 2)
    along, span, shears = (
        a.reshape(n, n, 2, 2) for a in (seen.by_facet, seen.by_source, seen.position_by_facet)
    )  # fmt: skip
    return Patches(landings, along + span @ given, places, shears)


def cost_of_lost_light(scene: Scene) -> float:
    """Mean squared difference, in display values, of a target pixel and a random pixel of the source."""
    total = 0.0
    for view in scene.views:
        s, t = to_display(view.source), to_display(view.target)
        total += float((s**2).mean() - 2 * s.mean() * t.mean() + (t**2).mean())
    return total / len(scene.views)


def _eyes(scene: Scene) -> FloatArray:
    """(V, 3) the different eyes of all views, lens frame, mm."""
    eyes: FloatArray = np.unique(np.stack([view.eye_in_lens_frame_mm for view in scene.views]).round(9), axis=0)
    return eyes


def _flat(n: int, offsets: FloatArray, maps: FloatArray) -> tuple[FloatArray, FloatArray]:
    return offsets.reshape(n * n, -1, 2).astype(np.float64), maps.reshape(n * n, -1, 3).astype(np.float64)
