"""Checks of the light that passes the exported top: slopes, Fresnel loss and total reflection, by facet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from magiclens.contract.artifacts import BoolArray, Lens
from magiclens.preflight.finding import Finding, facets_where, graded, worst_facet_text
from magiclens.preflight.triangles import TopTriangles, angles_deg

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


def check_fresnel_loss(top: TopTriangles, lens: Lens, traced: Sequence[TracedTriangles]) -> Finding:
    """Measure the share of the picture that is seen at a grazing angle, and so reflects the surroundings.

    Args:
        top: The triangles of the top.
        lens: The lens.
        traced: What each view's eye sees of them.
    """
    angles = [angles_deg(seen) for seen in traced]
    bad, share = _bad_triangles(top, traced, [angle > _GRAZING_DEG for angle in angles])
    facets = facets_where(bad, top.facet, np.max(angles, axis=0), lens)
    slanting = f"is seen at more than {_GRAZING_DEG:g} deg from the normal"
    text = f"{100 * share:.2g} % of the picture {slanting}{worst_facet_text(facets)}"
    return Finding("Fresnel loss", graded(share, SMALL_SHARE, _LARGE_SHARE), text, facets)


def check_total_reflection(top: TopTriangles, lens: Lens, traced: Sequence[TracedTriangles]) -> Finding:
    """Measure the share of the picture that shows no source, since the flat bottom reflects its light totally.

    Args:
        top: The triangles of the top.
        lens: The lens.
        traced: What each view's eye sees of them.
    """
    bad, share = _bad_triangles(top, traced, [(seen.through == 0) & (seen.area > 0) for seen in traced])
    facets = facets_where(bad, top.facet, top.slope_deg, lens)
    text = f"{100 * share:.2g} % of the picture is reflected totally at the bottom{worst_facet_text(facets)}"
    return Finding("total reflection", graded(share, SMALL_SHARE, _LARGE_SHARE), text, facets)


def _bad_triangles(
    top: TopTriangles, traced: Sequence[TracedTriangles], bad: Sequence[BoolArray]
) -> tuple[BoolArray, float]:
    """(F,) triangles of facets that are bad for any eye, and the share of the picture they fill for the worst eye."""
    areas = [np.where(top.wall, 0.0, seen.area) for seen in traced]
    shares = [float(area[b].sum() / max(area.sum(), 1e-12)) for area, b in zip(areas, bad, strict=True)]
    wrong = np.any([(area > 0) & b for area, b in zip(areas, bad, strict=True)], axis=0)
    return wrong, max(shares)
