"""The body of a lens as splines need it: the grid of its top, and the flat floor below each line of the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magiclens import FloatArray, InputError, IntArray, Lens, Solid

_THIN_MM = 1e-3
"""A rim narrower than this is left out: nobody would see it on the finished part."""
FLAT_MM = 1e-6
"""Points that are less than this beside a plane are on it."""


@dataclass(frozen=True)
class LensBody:
    """A solid between a grid on top and a rectangular floor, lens frame, mm.

    top: (G, G, 3) float64, rows from +y down. rim: 1 if the outermost lines lie beyond the facets, else 0.
    floor_x, floor_y: (G,) x of the floor below each column, and y below each row. floor_z: height of the floor.
    """

    top: FloatArray
    rim: int
    floor_x: FloatArray
    floor_y: FloatArray
    floor_z: float


def lens_body(lens: Lens, solid: Solid) -> LensBody:
    """The body of a solid. Raises InputError if its grid is not that of the lens, or if it has no rectangular floor."""
    g = lens.facets * (lens.microfacets + 1) + 2
    if solid.grid != (g, g):
        raise _unfit("the finisher's mesh has lost the facets' grid")
    floor = _floor(solid, g)
    if floor is None:
        raise _unfit("the finisher's mesh does not stand on a flat rectangle")
    top = solid.vertices[: g * g].reshape(g, g, 3)
    rim = int(lens.bleed_mm + lens.wall_mm / 2 >= _THIN_MM)
    kept = slice(1 - rim, g - 1 + rim)
    return LensBody(top[kept, kept], rim, floor[0, kept, 0], floor[kept, 0, 1], float(floor[0, 0, 2]))


def _unfit(why: str) -> InputError:
    return InputError(f"splines need facets, and {why}; the nearest is 'surface: triangles'", "exporter step: surface")


def _floor(solid: Solid, g: int) -> FloatArray | None:
    """(g, g, 3) whose border lies below the top's: the ring of vertices after those of the grid. None if there is none.

    Below its top, the mesh must be two triangles per border edge, and flat inside the ring.
    """
    border, ring = _border(g), g * g + np.arange(4 * (g - 1))
    lower = solid.faces[(solid.faces >= g * g).any(axis=1)].astype(np.int64)
    inside = len(solid.vertices) - ring[-1] - 1
    if inside < 0 or len(lower) != 3 * len(ring) + 2 * (inside - 1):
        return None
    ends = np.concatenate([lower[:, [k, (k + 1) % 3]] for k in range(3)])
    edges = np.sort(ends, axis=1) @ [len(solid.vertices), 1]
    if not np.isin(border * len(solid.vertices) + ring, edges).all():
        return None
    left, bottom = solid.vertices[ring[: g - 1]], solid.vertices[ring[g - 1 : 2 * g - 1]]
    rows = np.append(left[:, 1], bottom[0, 1])
    floor = np.stack(np.broadcast_arrays(bottom[:, 0], rows[:, None], bottom[0, 2]), axis=-1)
    off = floor.reshape(-1, 3)[border] - solid.vertices[ring]
    level = solid.vertices[g * g :, 2] - bottom[0, 2]
    return floor if max(np.abs(off).max(), np.abs(level).max()) < FLAT_MM else None


def _border(g: int) -> IntArray:
    """Indices of the grid's border vertices, counter-clockwise as the viewer sees them."""
    index = np.arange(g * g).reshape(g, g)
    return np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
