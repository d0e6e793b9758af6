"""Checks of the light that passes the exported top: slopes, Fresnel loss and total reflection, by facet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, Lens
from magiclens.preflight.finding import Finding, facets_where, graded, worst_facet_text
from magiclens.preflight.triangles import TopTriangles

if TYPE_CHECKING:
    from magiclens.preflight.triangles_kernels import TracedTriangles

_GRAZING_DEG = 60.0
"""Angle between normal and ray from which a clear surface reflects a tenth of the light; the share soon grows."""
SMALL_SHARE = 0.001
"""Share of the picture, or of the faces, up to which a fault does not matter."""
_LARGE_SHARE = 0.05
"""Share of the picture from which a fault is too much."""


def check_slopes(top: TopTriangles, lens: Lens, limit_deg: float, limit_name: str) -> Finding:
    """Compare the steepest facet with a limit.

    Args:
        top: The triangles of the top.
        lens: The lens.
        limit_deg: The limit of the machine or of the spec.
        limit_name: What allows it, as the text calls it.
    """
    inside = ~top.wall
    steepest = float(top.slope_deg[inside].max())
    bad = inside & (top.slope_deg > limit_deg + 0.5)
    facets = facets_where(bad, top.facet, top.slope_deg, lens)
    text = f"facets are up to {steepest:.1f} deg steep, {limit_name} allows {limit_deg:g} deg{worst_facet_text(facets)}"
    # An edge between lenslets that meet badly may be steeper than either: only much of it is a mistake.
    return Finding("slopes", graded(float(bad.sum() / inside.sum()), 0.0, SMALL_SHARE), text, facets)


class SeenTop(NamedTuple):
    """What is known of the triangles of the top as eyes see them.

    Args:
        angle_deg: (F,) float32, the largest angle between the normal and the ray of any eye.
        grazing: (F,) whether a triangle belongs to a facet that an eye sees at a grazing angle.
        lost: (F,) whether it belongs to one whose light the flat bottom reflects totally.
    """

    angle_deg: FloatArray
    grazing: BoolArray
    lost: BoolArray


def seen_top(wall: BoolArray, traced: Sequence[TracedTriangles]) -> tuple[SeenTop, FloatArray]:
    """What eyes see of triangles of the top.

    Args:
        wall: (F,) whether they belong to no facet.
        traced: Their triangles as each eye sees them.

    Returns:
        SeenTop, and (E, 3) how much of the picture each eye sees on facets, at grazing angles and without source, mm^2.
    """
    angles = [np.degrees(np.arccos(np.clip(seen.cosine, -1, 1))) for seen in traced]
    on_facets = [(seen.area > 0) & ~wall for seen in traced]
    grazing = [inside & (angle > _GRAZING_DEG) for inside, angle in zip(on_facets, angles, strict=True)]
    lost = [inside & (seen.through == 0) for inside, seen in zip(on_facets, traced, strict=True)]
    which = zip(traced, on_facets, grazing, lost, strict=True)
    areas = np.array([[seen.area[some].sum() for some in parts] for seen, *parts in which])
    angle = np.max(angles, axis=0).astype(np.float32)
    return SeenTop(angle, np.any(grazing, axis=0), np.any(lost, axis=0)), areas


def check_fresnel_loss(top: TopTriangles, seen: SeenTop, areas_mm2: FloatArray, lens: Lens) -> Finding:
    """Grade the share of the picture that is seen at a grazing angle, and so reflects the surroundings.

    Args:
        top: The triangles of the top.
        seen: The same as eyes see them.
        areas_mm2: (E, 3), see ``seen_top``.
        lens: The lens.
    """
    share = _worst_share(areas_mm2, 1)
    facets = facets_where(seen.grazing, top.facet, seen.angle_deg, lens)
    slanting = f"is seen at more than {_GRAZING_DEG:g} deg from the normal"
    text = f"{100 * share:.2g} % of the picture {slanting}{worst_facet_text(facets)}"
    return Finding("Fresnel loss", graded(share, SMALL_SHARE, _LARGE_SHARE), text, facets)


def check_total_reflection(top: TopTriangles, seen: SeenTop, areas_mm2: FloatArray, lens: Lens) -> Finding:
    """Grade the share of the picture that shows no source, since the flat bottom reflects its light totally.

    Args:
        top: The triangles of the top.
        seen: The same as eyes see them.
        areas_mm2: (E, 3), see ``seen_top``.
        lens: The lens.
    """
    share = _worst_share(areas_mm2, 2)
    facets = facets_where(seen.lost, top.facet, top.slope_deg, lens)
    text = f"{100 * share:.2g} % of the picture is reflected totally at the bottom{worst_facet_text(facets)}"
    return Finding("total reflection", graded(share, SMALL_SHARE, _LARGE_SHARE), text, facets)


def _worst_share(areas_mm2: FloatArray, column: int) -> float:
    """The share of the picture that a column of areas fills for the worst eye."""
    return float((areas_mm2[:, column] / np.maximum(areas_mm2[:, 0], 1e-12)).max())
