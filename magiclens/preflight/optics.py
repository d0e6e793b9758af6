"""Does light get through? Slopes, Fresnel loss and total reflection, facet by facet, of the exported top."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Lens
from magiclens.preflight.finding import Finding, facets_with, first_of, graded
from magiclens.preflight.sight import Sight

STRONG_DEG = 60.0
"""Between normal and view; beyond, a clear surface reflects a tenth of the light and soon much more."""
FEW, MANY = 0.001, 0.05
"""Shares of the picture that are worth a look, and too much."""


@dataclass(frozen=True)
class Top:
    """The triangles of the top, (F, 3, 3). facet: (F,) row * N + column; wall: (F,) of no facet; slope_deg: (F,)."""

    triangles: FloatArray
    facet: IntArray
    wall: BoolArray
    slope_deg: FloatArray


def slopes(top: Top, lens: Lens, limit_deg: float, name: str) -> Finding:
    """The steepest facet against what the machine, or the spec, allows."""
    inside = ~top.wall
    steepest = float(top.slope_deg[inside].max())
    bad = inside & (top.slope_deg > limit_deg + 0.5)
    facets = facets_with(bad, top.facet, top.slope_deg, lens)
    text = f"facets are up to {steepest:.1f} deg steep, {name} allows {limit_deg:g} deg{first_of(facets)}"
    # An edge between lenslets that meet badly may be steeper than either: only much of it is a mistake.
    return Finding("slopes", graded(float(bad.sum() / inside.sum()), 0.0, FEW), text, facets)


def loss(top: Top, lens: Lens, sights: Sequence[Sight]) -> Finding:
    """How much of the picture is seen so slantingly that it reflects the surroundings."""
    bad, share = _share(top, sights, [sight.angle_deg > STRONG_DEG for sight in sights])
    angle = np.max([sight.angle_deg for sight in sights], axis=0)
    facets = facets_with(bad, top.facet, angle, lens)
    slanting = f"is seen at more than {STRONG_DEG:g} deg from the normal"
    text = f"{100 * share:.2g} % of the picture {slanting}{first_of(facets)}"
    return Finding("Fresnel loss", graded(share, FEW, MANY), text, facets)


def reflection(top: Top, lens: Lens, sights: Sequence[Sight]) -> Finding:
    """How much of the picture shows no source, as the flat bottom reflects its light."""
    bad, share = _share(top, sights, [(sight.through == 0) & (sight.area > 0) for sight in sights])
    facets = facets_with(bad, top.facet, top.slope_deg, lens)
    text = f"{100 * share:.2g} % of the picture is reflected totally at the bottom{first_of(facets)}"
    return Finding("total reflection", graded(share, FEW, MANY), text, facets)


def _share(top: Top, sights: Sequence[Sight], bad: Sequence[BoolArray]) -> tuple[BoolArray, float]:
    """Triangles of facets that are bad for some eye, and the share of the picture that they fill for the worst eye."""
    seen = [np.where(top.wall, 0.0, sight.area) for sight in sights]
    shares = [float(area[b].sum() / max(area.sum(), 1e-12)) for area, b in zip(seen, bad, strict=True)]
    wrong = np.any([(area > 0) & b for area, b in zip(seen, bad, strict=True)], axis=0)
    return wrong, max(shares)
