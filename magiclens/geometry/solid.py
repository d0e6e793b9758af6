"""Closed bodies under a grid of points, manifold by construction: the grid on top, sides, a flat bottom at z = 0."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from dataclasses import replace

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, HeightField, IntArray, Lens, Solid
from magiclens.geometry.mark import with_mark

FACES_AT_ONCE = 1 << 13
"""So many faces' corners, and what is computed of them, fit into a processor's cache: larger parts take longer."""
_INNER_POINTS, _INSET = 64, 0.9
"""Most points of the ring inside the floor's outline, and how much smaller it is.

Thousands of slivers that met in the middle would slow down every search for the triangle that a ray meets.
"""


def solid_from_heights(heights: HeightField) -> Solid:
    """The lens under a height field: top grid, sides along the cutting rays or flatter, flat bottom at z = 0.

    If the lens has a mark, the middle of its upper side leans out to it, so that no point of the top moves.
    """
    lens, eye = heights.lens, heights.eye_mm
    lines = grid_lines(lens)
    h = height_grid(heights)
    u, v = np.meshgrid(lines, -lines)
    top = heights.points_mm(u, v, h)
    rim = _border(*h.shape)
    foot = _dropped(heights.points_mm(u.ravel()[rim], v.ravel()[rim], np.zeros(len(rim))), eye)
    floor = _widened(foot, lens.floor_mm / 2)
    solid = solid_from_grid(top, with_mark(floor) if lens.mark else floor, eye)
    width, depth, height = np.ptp(solid.vertices, axis=0).tolist()
    return replace(
        solid, metrics={"volume_mm3": volume(solid), "width_mm": width, "depth_mm": depth, "height_mm": height}
    )


def solid_from_raster(x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray, floor_mm: float = 0.0) -> Solid:
    """The body under heights on a raster, with vertical cells.

    Its floor is the top's outline, or a square where that is larger.

    Args:
        x_mm: (columns,) ascending.
        y_mm: (rows,) descending.
        z_mm: (rows, columns) heights above every (x_mm[column], y_mm[row]).
        floor_mm: side of the square that the floor holds at least.
    """
    top = np.stack([*np.meshgrid(x_mm, y_mm), z_mm], axis=-1)
    rim = top.reshape(-1, 3)[_border(*z_mm.shape)]
    half = np.abs(rim[:, :2]).max(axis=0)
    return solid_from_grid(top, rim * (*np.maximum(floor_mm / 2 / half, 1.0), 0.0))


def solid_from_grid(top: FloatArray, floor: FloatArray, eye_mm: FloatArray | None = None) -> Solid:
    """The body under a grid of points.

    Every cell is cut from its top-left to its bottom-right corner; the bottom is a strip along the floor's outline and
    a fan about the floor's mean.

    Args:
        top: (rows, columns, 3) mm, lens frame, row 0 at +y and column 0 at -x.
        floor: (B, 3) points of z = 0 below the top's border points, mm, counter-clockwise from the top-left corner.
        eye_mm: (3,) the eye along whose rays the top's cells are cut; None if they are vertical.
    """
    rows, columns = top.shape[:2]
    middle = floor.mean(axis=0)
    inner = middle + _INSET * (floor[:: _outline_per_inner(len(floor))] - middle)
    vertices = np.concatenate([top.reshape(-1, 3), floor, inner, middle[None]])
    return Solid(vertices, np.concatenate([*_faces_of_grid(rows, columns)]), (rows, columns), eye_mm)


def _faces_of_grid(rows: int, columns: int) -> tuple[IntArray, IntArray]:
    """The faces of ``solid_from_grid``, (F, 3) int32: those of the top, and those below."""
    below = _faces_below(_border(rows, columns), rows * columns)
    return top_faces(rows, columns), below.astype(np.int32)


def is_built_on_grid(solid: Solid) -> bool:
    """Whether a solid has the faces of ``solid_from_grid``, so that it is closed, manifold and one body."""
    if solid.grid is None:
        return False
    top, below = _faces_of_grid(*solid.grid)
    last = int(below.max())
    return (
        len(solid.faces) == len(top) + len(below)
        and len(solid.vertices) == last + 1
        and np.array_equal(solid.faces[: len(top)], top)
        and np.array_equal(solid.faces[len(top) :], below)
    )


def faces_in_parts(faces: Sized) -> Iterator[slice]:
    """Consecutive parts of the faces of a mesh, which is too large to look at all corners at once."""
    for first in range(0, len(faces), FACES_AT_ONCE):
        yield slice(first, first + FACES_AT_ONCE)


def top_faces(rows: int, columns: int) -> IntArray:
    """(F, 3) int32, the two triangles of every cell of a grid of vertices, cell after cell.

    Cells are cut from their top-left to their bottom-right corner; the lower left triangle comes first.
    """
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    tl, tr, bl, br = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    return np.stack([tl, bl, br, tl, br, tr], axis=-1).reshape(-1, 3)


def facet_faces(lens: Lens) -> BoolArray:
    """(F,) whether a triangle of ``top_faces`` belongs to a facet rather than to a wall or to the rim."""
    period = lens.microfacets + 1
    line = np.arange(lens.facets * period + 1) - 1
    inside = line % period != lens.microfacets
    return np.repeat((inside[:, None] & inside).ravel(), 2)


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
    onward = beyond / (lens.pitch_mm - lens.wall_mm) * lens.microfacets  # in micro-facets
    whole = carried_on(inner, np.array([onward]))
    return np.clip(whole, -lens.relief_mm, lens.relief_mm) if lens.bleed_mm else whole


def carried_on(grid: FloatArray, onward: FloatArray) -> FloatArray:
    """A grid of heights that goes on beyond its border with the slope of its outermost cells.

    Args:
        grid: (rows, columns) mm, at least two of each.
        onward: (B,) descending, how many cells beyond the border the new lines lie.

    Returns:
        (rows + 2 B, columns + 2 B) mm.
    """
    far = onward[:, None]
    for _ in range(2):  # rows first, then columns
        first, last = grid[:1] - far * (grid[1:2] - grid[:1]), grid[-1:] + far[::-1] * (grid[-1:] - grid[-2:-1])
        grid = np.concatenate([first, grid, last]).T
    return grid


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
    sixfold = np.empty(len(solid.faces))
    for part in faces_in_parts(solid.faces):
        a, b, c = (solid.vertices.take(solid.faces[part, k], axis=0) for k in range(3))
        sixfold[part] = np.einsum("ij,ij->i", a, np.cross(b, c))
    return float(sixfold.sum() / 6)


def _border(rows: int, columns: int) -> IntArray:
    """(B,) indices of a grid's border points, counter-clockwise as the viewer sees them, from the top-left corner."""
    index = np.arange(rows * columns).reshape(rows, columns)
    return np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])


def _faces_below(rim: IntArray, first: int) -> IntArray:
    """Two triangles between each border edge and the floor edge below, whose points start at ``first``; the floor."""
    low, step = first + np.arange(len(rim)), _outline_per_inner(len(rim))
    a, b, c, d = rim, np.roll(rim, -1), low, np.roll(low, -1)
    inner = np.arange(low[-1] + 1, low[-1] + 1 + -(-len(rim) // step))
    near = inner[(np.arange(len(rim)) + step // 2) // step % len(inner)]
    following = np.roll(near, -1)
    turn = near != following
    sides = [np.stack([a, c, d], axis=-1), np.stack([a, d, b], axis=-1)]
    strip = [np.stack([c, near, d], axis=-1), np.stack([d, near, following], axis=-1)[turn]]
    fan = np.stack([inner, np.full_like(inner, inner[-1] + 1), np.roll(inner, -1)], axis=-1)
    return np.concatenate([*sides, *strip, fan])


def _outline_per_inner(count: int) -> int:
    """How many of the ``count`` points of the floor's outline there are for every point of the ring inside it."""
    return -(-count // _INNER_POINTS)


def _dropped(plane: FloatArray, eye: FloatArray | None) -> FloatArray:
    """Points of the reference plane (V, 3) moved down to z = 0 along their rays."""
    if eye is None:
        return plane * (1, 1, 0)
    down: FloatArray = eye + (plane - eye) * (eye[2] / (eye[2] - plane[:, 2:]))
    down[:, 2] = 0.0
    return down


def _widened(floor: FloatArray, half: float) -> FloatArray:
    """Points of a rectangle's rim (V, 3) stretched until it holds the square of half side ``half`` about the axis."""
    if half <= 0.0:
        return floor
    low, high = floor.min(axis=0), floor.max(axis=0)
    wide = np.where(high > low, high - low, 1.0)
    to_low, to_high = np.minimum(low, -half), np.maximum(high, half)
    out: FloatArray = to_low + (floor - low) / wide * (to_high - to_low)
    out[:, 2] = floor[:, 2]
    return out
