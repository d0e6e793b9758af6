"""From heights to a closed mesh, manifold by construction: a regular grid on top, sides, a flat bottom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Solid
from magiclens.geometry.slab import border, slab


def grid_lines(lens: Lens) -> FloatArray:
    """(G,) float64: where the top's grid lines cross the x axis of the reference plane, mm, G = N (m + 1) + 2.

    Every facet owns m + 1 lines; a wall lies between the last line of one facet and the first of the next; half a wall
    and the lens's bleed form the rim. The y axis has the same lines, negated in order.
    """
    side = lens.pitch_mm - lens.wall_mm
    within = np.linspace(-side / 2, side / 2, lens.microfacets + 1)
    centres = (np.arange(lens.facets) + 0.5) * lens.pitch_mm - lens.size_mm / 2
    edge = lens.size_mm / 2 + lens.bleed_mm
    return np.concatenate([[-edge], (centres[:, None] + within).ravel(), [edge]])


def height_grid(heights: HeightField) -> FloatArray:
    """(G, G) heights on the grid lines, rows from +y down; the rim goes on with the slope of the outer micro-facets."""
    n, _, k, _ = heights.heights_mm.shape
    inner = heights.heights_mm.transpose(0, 2, 1, 3).reshape(n * k, n * k)
    lens = heights.lens
    beyond = lens.bleed_mm + lens.wall_mm / 2 if lens.bleed_mm else 0.0
    onward = beyond / (lens.pitch_mm - lens.wall_mm) * lens.microfacets
    for _ in range(2):
        first, last = inner[:1] - onward * (inner[1:2] - inner[:1]), inner[-1:] + onward * (inner[-1:] - inner[-2:-1])
        inner = np.concatenate([first, inner, last]).T
    return np.clip(inner, -lens.relief_mm, lens.relief_mm) if lens.bleed_mm else inner


def solid_from_heights(heights: HeightField) -> Solid:
    """The slab under a height field: top grid, sides along the cutting rays or flatter, flat bottom at z = 0."""
    lens, eye = heights.lens, heights.eye_mm
    lines = grid_lines(lens)
    h = height_grid(heights)
    u, v = np.meshgrid(lines, -lines)
    top = heights.points_mm(u, v, h)
    rim = border(*h.shape)
    floor = _spread(_drop(heights.points_mm(u, v, np.zeros_like(h)).reshape(-1, 3)[rim], eye), lens.floor_mm / 2)
    solid = slab(top, floor, eye)
    return replace(solid, metrics={"volume_mm3": volume(solid)})


def heights_of(solid: Solid, lens: Lens) -> FloatArray | None:
    """(N, N, m + 1, m + 1) heights as of ``HeightField``, read back from a solid; None if it lost the lens's grid."""
    lines = len(grid_lines(lens))
    if solid.grid != (lines, lines):
        return None
    z = solid.vertices[: lines**2, 2].reshape(lines, lines)[1:-1, 1:-1]
    if solid.eye_mm is None:
        h = z - lens.thickness_mm
    else:
        far = solid.eye_mm[2] - lens.thickness_mm
        h = -far * np.log((solid.eye_mm[2] - z) / far)
    n, k = lens.facets, lens.microfacets + 1
    return h.reshape(n, k, n, k).transpose(0, 2, 1, 3)


def volume(solid: Solid) -> float:
    """Volume in mm^3 (divergence theorem), positive for outward normals."""
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def _drop(plane: FloatArray, eye: FloatArray | None) -> FloatArray:
    """Points of the reference plane (V, 3) moved down to z = 0 along their rays."""
    if eye is None:
        return plane * (1, 1, 0)
    down: FloatArray = eye + (plane - eye) * (eye[2] / (eye[2] - plane[:, 2:]))
    down[:, 2] = 0.0
    return down


def _spread(floor: FloatArray, half: float) -> FloatArray:
    """Points of a rectangle's rim (V, 3) stretched until it holds the square of half side ``half`` about the axis."""
    if half <= 0.0:
        return floor
    low, high = floor.min(axis=0), floor.max(axis=0)
    wide = np.where(high > low, high - low, 1.0)
    to_low, to_high = np.minimum(low, -half), np.maximum(high, half)
    out: FloatArray = to_low + (floor - low) / wide * (to_high - to_low)
    out[:, 2] = floor[:, 2]
    return out
