"""The built-in ray tracer, compiled: what each point of the lens's square shows to an eye, and how strongly.

One path per sample, followed from the eye: where light splits into a refracted and a reflected part, the stronger
one is followed and its share kept. Rays may leave through walls and enter again. The source is an emitter below the
flat bottom; whatever ends elsewhere is black.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.sampling import rotated_grid
from magiclens.kernels.threads import in_threads
from magiclens.kernels.uncounted import uncounted
from magiclens.optics.medium import Slab
from magiclens.optics.refraction import refract, transmittance
from magiclens.rendering.cone_kernels import STEEP
from magiclens.rendering.grid import BLOCK_CELLS, Grid
from magiclens.rendering.straight_path_kernels import (
    BATCH,
    goes_in,
    goes_through,
    room_for_batch,
    straight_through,
    way_in,
    way_out,
)  # fmt: skip

_MOST_EVENTS = 8
"""Number of refractions and reflections after which a path counts as lost."""
_BELOW = 1e-12
"""Least depth below the surface, in w, that counts as having crossed it: rounding leaves a ray's start on it."""
_CLEARANCE_MM = 1e-3
"""Height above the highest vertex at which paths start, mm; twice as high, upward rays are given up."""

_EITHER, _UPPER, _LOWER = 0, 1, 2
"""Halves of a grid's cell: upper right (top left, bottom right, top right) and lower left; either of them."""
_MISSED, _LEFT_GRID = 2.0, 3.0
"""Shares of a segment, beyond its end at 1, that say that it meets no surface, or that it leaves the grid before."""
_LOST = (0.0, 0.0, 0.0, 0.0, 0.0)
"""What ``_follow`` says of a path that does not reach the source."""


class PictureRows(NamedTuple):
    """The rows of a picture that are traced.

    Args:
        size: side of the picture, the lens's square on the reference plane, mm.
        resolution: pixels along the picture's side.
        samples: samples along a pixel's side.
        first: first row.
        end: row after the last.
    """

    size: float
    resolution: int
    samples: int
    first: int
    end: int


@njit(cache=True, nogil=True)
def _trace_part(part, grid, slab, eye, rows, hits):
    """Part of the rows, see ``trace_rows``, or ``trace_rays`` where there is room for ways; hits: to fill."""
    grid = uncounted(grid)
    samples = rows.samples
    pixel = rows.size / rows.resolution
    places = np.zeros((samples * samples, 2))
    for k in range(samples * samples):
        places[k, 0], places[k, 1] = rotated_grid(k, samples)
    paths, columns = rows.resolution * samples * samples, hits.shape[3]
    across, down, cells, lines = np.empty(paths), np.empty(paths), np.empty(paths, np.int64), np.empty(paths, np.int64)
    near = np.int64(0)
    for path in range(paths):
        j, k = path // (samples * samples), path % (samples * samples)
        across[path] = (j + places[k, 0]) * pixel - 0.5 * rows.size
        cells[path] = near = _column(grid.us, across[path], near)
    numbers, entries = room_for_batch(), np.empty((BATCH, 2), np.int64)
    near = np.int64(0)
    for row in range(part.first, part.end):
        for k in range(samples * samples):
            qy = 0.5 * rows.size - (rows.first + row + places[k, 1]) * pixel
            near = _row(grid.vs, qy, near)
            for path in range(k, paths, samples * samples):
                down[path], lines[path] = qy, near
        into = hits[row].reshape(-1)
        for first in range(0, paths, BATCH):
            some = slice(first, min(first + BATCH, paths))
            for n in range(some.stop - first):
                entries[n, 0], entries[n, 1] = lines[first + n], cells[first + n]
            straight_through(grid, slab, eye, across[some], down[some], entries, numbers)
            for n in range(some.stop - first):
                if goes_through(numbers, n):
                    x, y, weight, along_x, along_y = way_out(numbers, n)
                else:
                    if goes_in(numbers, n):
                        point, way, place, upper, weight = way_in(numbers, n)
                        half = np.int64(_UPPER if upper else _LOWER)
                        ray = point, way, place, (entries[n, 0], entries[n, 1]), half, True, weight
                    else:
                        ray = _arriving(grid, slab, eye, (across[first + n], down[first + n]), entries[n])
                    x, y, weight, along_x, along_y = _follow(grid, slab, ray)
                at = (first + n) * columns
                if columns == 5:
                    into[at + 3], into[at + 4] = along_x, along_y
                else:
                    x, y = x + slab.gap * along_x, y + slab.gap * along_y
                into[at], into[at + 1], into[at + 2] = x, y, weight


def trace_rows(grid: Grid, slab: Slab, eye: FloatArray, rows: PictureRows) -> FloatArray:
    """``_follow`` the path of every sample of a picture's rows.

    Args:
        grid: the top, a ``rendering.grid.Grid``.
        slab: the glass, an ``optics.medium.Slab``.
        eye: (3,) mm, lens frame.
        rows: which pixels, a ``PictureRows``.

    Returns:
        (rows, resolution, samples^2, 3) float32: source point x, y, mm, lens frame, and transmission.
    """
    return _traced(grid, slab, eye, rows, 3)


def trace_rays(grid: Grid, slab: Slab, eye: FloatArray, rows: PictureRows) -> FloatArray:
    """The same down to the flat bottom, for a source in any place; the slab's gap does not count.

    Returns:
        (rows, resolution, samples^2, 5) float32: x and y, mm, where a ray leaves the flat bottom, its transmission, and
        how far it goes on along x and y for each mm that it falls.
    """
    return _traced(grid, slab, eye, rows, 5)


def _traced(grid: Grid, slab: Slab, eye: FloatArray, rows: PictureRows, columns: int) -> FloatArray:
    hits = np.empty((rows.end - rows.first, rows.resolution, rows.samples**2, columns), np.float32)
    in_threads(_trace_part, len(hits), grid, slab, eye, rows, hits)
    return hits


@njit(cache=True, forceinline=True)
def _arriving(grid, slab, eye, through, near):
    """The ray that ``_follow`` is given: from an eye to the grid, toward a point of the reference plane.

    Args:
        grid: the top.
        slab: the glass.
        eye: (3,) mm.
        through: x and y of the point, mm.
        near: row and column of a cell near the path's first, from which that one is looked for.
    """
    dx, dy, dz = through[0] - eye[0], through[1] - eye[1], slab.depth - eye[2]
    q = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * q, dy * q, dz * q
    rise = (grid.highest + _CLEARANCE_MM - eye[2]) / dz
    x, y, z = eye[0] + dx * rise, eye[1] + dy * rise, grid.highest + _CLEARANCE_MM
    u0, v0, w0 = _to_grid(grid, x, y, z)
    u1, v1, w1 = _to_grid(grid, x - dx * z / dz, y - dy * z / dz, 0.0)
    at = _entry(grid.us, grid.vs, (u0, v0), (u1, v1))
    u0, v0, w0 = u0 + at * (u1 - u0), v0 + at * (v1 - v0), w0 + at * (w1 - w0)
    r, c = _row(grid.vs, v0, near[0]), _column(grid.us, u0, near[1])
    ws, weight = grid.ws, 1.0
    if at > 1.0 or (at > 0.0 and w0 < max(ws[r, c], ws[r, c + 1], ws[r + 1, c], ws[r + 1, c + 1])):
        weight = 0.0  # it misses the grid, or meets the slab's side
    # the ray goes down, so it is not inside; numba would compile the march apart for literals
    return _from_grid(grid, u0, v0, w0), (dx, dy, dz), (u0, v0, w0), (r, c), np.int64(_EITHER), dz > 0.0, weight


@njit(cache=True, forceinline=True)
def _follow(grid, slab, ray):
    """The path of a ray to the flat bottom, and on.

    At every surface it goes on as ``refract(d, n, eta)`` with the weight ``T``, or, where T < 1/2, as
    ``d + 2 cos_i n`` with the weight ``1 - T``; T is Fresnel's ``transmittance(cos_i, eta)``. Between surfaces,
    ``_march`` crosses the grid's cells.

    Args:
        grid: the top.
        slab: the glass.
        ray: x, y and z of where it starts, mm; its direction; u, v and w of where it starts; row and column of the cell
            there, and the half of it if it starts on the surface; whether it is in the glass; and its transmission,
            0 if it is lost.

    Returns:
        x and y, mm, where it leaves the bottom, the transmission, and how far it goes on along x and y per mm that it
        falls; all 0 where light is lost.
    """
    (x, y, z), (dx, dy, dz), (u0, v0, w0), (r, c), half, inside, weight = ray
    for _ in range(_MOST_EVENTS):
        if dz == 0.0 or weight == 0.0:
            break
        reach = (grid.highest + 2 * _CLEARANCE_MM - z) / dz if dz > 0.0 else -z / dz
        u1, v1, w1 = _to_grid(grid, x + dx * reach, y + dy * reach, z + dz * reach)
        # the triangle on which a segment starts is left out, or rounding would find it crossed at once
        at, r, c, half = _march(grid, (u0, v0, w0), (u1, v1, w1), (r, c), half, inside)
        if at >= _MISSED:
            lands = inside and dz < 0.0
            if lands and at == _LEFT_GRID:  # beyond the last facet the slab goes on as far as its sides lean out
                fx, fy = x - dx * z / dz, y - dy * z / dz
                lands = grid.floor_left <= fx <= grid.floor_right and grid.floor_bottom <= fy <= grid.floor_top
            if lands:
                return _leave((x, y, z), (dx, dy, dz), weight, slab)
            break
        u0, v0, w0 = u0 + at * (u1 - u0), v0 + at * (v1 - v0), w0 + at * (w1 - w0)
        x, y, z = _from_grid(grid, u0, v0, w0)
        nx, ny, nz = _facing(grid.points, r, c, half == _UPPER)
        sign = -1.0 if inside else 1.0
        nx, ny, nz = sign * nx, sign * ny, sign * nz
        eta = 1.0 / slab.ior if inside else slab.ior  # the normal is now on the side that the ray comes from
        cos_i = -(dx * nx + dy * ny + dz * nz)
        share = transmittance(max(cos_i, 0.0), eta)
        if share >= 0.5:
            dx, dy, dz = refract(dx, dy, dz, nx, ny, nz, eta)
            inside = not inside
            weight *= share
        else:
            dx, dy, dz = dx + 2.0 * cos_i * nx, dy + 2.0 * cos_i * ny, dz + 2.0 * cos_i * nz
            weight *= 1.0 - share
    return _LOST


@njit(cache=True, forceinline=True)
def _leave(point, direction, weight, slab):
    """Through the flat bottom, see ``_follow``; 0 on total reflection."""
    x, y, z = point
    dx, dy, dz = direction
    weight *= transmittance(-dz, 1.0 / slab.ior)
    ox, oy, oz = refract(dx, dy, dz, 0.0, 0.0, 1.0, 1.0 / slab.ior)
    if weight > 0.0 and oz < 0.0:
        return x - dx * z / dz, y - dy * z / dz, weight, -ox / oz, -oy / oz
    return _LOST


@njit(cache=True, forceinline=True)
def _end(grid, u1, v1):
    """What ``_march`` says of a segment that meets no surface, by u and v of its end."""
    us, vs = grid.us, grid.vs
    return _MISSED if us[0] <= u1 <= us[-1] and vs[-1] <= v1 <= vs[0] else _LEFT_GRID


@njit(cache=True, forceinline=True)
def _march(grid, start, end, cell, skipped, inside):
    """Follow a segment through the grid's cells until it crosses the surface.

    In each cell the segment's height above a triangle's plane is linear, ``f0 + t df``; it changes triangle where it
    crosses the cell's diagonal. Cells of a block of which the segment stays clear, by its bounds, are only passed. A
    segment that falls is followed no farther once it is below all of the blocks around, and will leave these below
    the lowest vertex of all.

    Args:
        grid: the top.
        start: u, v, w of the segment's start.
        end: u, v, w of its end.
        cell: row and column of the cell that holds the start.
        skipped: half of the first cell on which the segment starts, which is left out; ``_EITHER`` for none.
        inside: whether the segment runs within the glass.

    Returns:
        Share of the segment at the crossing, ``_MISSED`` or ``_LEFT_GRID``; row, column and half of the triangle that
        is crossed.
    """
    us, vs = grid.us, grid.vs
    (u0, v0, w0), (u1, v1, w1), (r, c) = start, end, cell
    du, dv, dw = u1 - u0, v1 - v0, w1 - w0
    per_du, per_dv = 1.0 / du, 1.0 / dv
    # once in the glass, a line that is steep meets steep cells only, and none of them once it is below their cones
    steep = inside and -dw > grid.gentlest * max(abs(du), abs(dv))
    here = 0.0
    while True:
        high = w0 + here * dw
        block_r, block_c = r // BLOCK_CELLS, c // BLOCK_CELLS
        if dw < 0.0 and high < grid.lowest:
            return _end(grid, u1, v1), r, c, _EITHER
        out_u = ((us[c + 1] if du > 0 else us[c]) - u0) * per_du if du != 0.0 else 2.0
        out_v = ((vs[r] if dv > 0 else vs[r + 1]) - v0) * per_dv if dv != 0.0 else 2.0
        leave = min(out_u, out_v, 1.0)
        low = w0 + leave * dw
        low, high = min(low, high), max(low, high)
        clear = high < grid.lows[block_r, block_c] if inside else low > grid.highs[block_r, block_c]
        if not clear and not (steep and grid.below[r, c] > STEEP):
            at, half = _meet(grid, (start, (du, dv, dw)), (r, c), skipped, (here, leave), inside)
            if at < _MISSED:
                return at, r, c, half
        if steep and low - grid.lowest <= grid.below[r, c]:
            return _end(grid, u1, v1), r, c, _EITHER
        skipped = _EITHER
        if leave >= 1.0:
            return _MISSED, r, c, _EITHER
        here = leave
        if out_u <= out_v:
            c += 1 if du > 0 else -1
        else:
            r += -1 if dv > 0 else 1
        if c < 0 or r < 0 or c > len(us) - 2 or r > len(vs) - 2:
            return _LEFT_GRID, r, c, _EITHER


@njit(cache=True, forceinline=True)
def _meet(grid, segment, cell, skipped, span, inside):
    """Where a segment crosses the surface in a cell, see ``_march``.

    Args:
        grid: the top.
        segment: u, v, w of its start, and of the way to its end.
        cell: row and column.
        skipped: half of the cell that is left out; ``_EITHER`` for none.
        span: shares of the segment at which it enters and leaves the cell.
        inside: whether it runs within the glass.

    Returns:
        Share of the segment at the crossing, or ``_MISSED``; half of the cell that is crossed.
    """
    ((u0, v0, w0), (du, dv, dw)), (r, c), (here, leave) = segment, cell, span
    us, vs, ws = grid.us, grid.vs, grid.ws
    side = 1.0 if inside else -1.0
    wide, tall = us[c + 1] - us[c], vs[r] - vs[r + 1]
    # s and t run from 0 to 1 along +x and -y of the cell; on its diagonal they are equal
    s0, ds = (u0 - us[c]) / wide, du / wide
    t0, dt = (vs[r] - v0) / tall, -dv / tall
    a, b, d, e = ws[r, c], ws[r, c + 1], ws[r + 1, c], ws[r + 1, c + 1]
    bend = (t0 - s0) / (ds - dt) if ds != dt else -1.0
    for piece in range(2):
        if piece == 0:
            first, last = here, bend if here < bend < leave else leave
        else:
            if not here < bend < leave:
                break
            first, last = bend, leave
        middle = 0.5 * (first + last)
        upper = s0 + ds * middle > t0 + dt * middle
        half = _UPPER if upper else _LOWER
        if skipped == half:
            continue
        if upper:
            f0, df = a + s0 * (b - a) + t0 * (e - b), ds * (b - a) + dt * (e - b)
        else:
            f0, df = a + t0 * (d - a) + s0 * (e - d), dt * (d - a) + ds * (e - d)
        f0, df = side * (w0 - f0), side * (dw - df)
        if f0 + df * last > _BELOW and last > first:
            at = -f0 / df if df != 0.0 else first
            return min(max(at, first), last), half
    return _MISSED, _EITHER


@njit(cache=True, forceinline=True)
def _facing(points, r, c, upper):
    """Upward unit normal, in space, of the upper right or the lower left triangle of a cell."""
    a, d = points[r, c], points[r + 1, c + 1]
    b = points[r, c + 1] if upper else points[r + 1, c]
    px, py, pz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    qx, qy, qz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    sign = 1.0 if upper else -1.0
    q = sign / math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * q, ny * q, nz * q


@njit(cache=True, forceinline=True)
def _to_grid(grid, x, y, z):
    """u, v, w of a point in space, mm; see ``rendering.grid``."""
    if grid.vertical:
        return x, y, z
    eye = grid.cut_eye
    w = grid.eye_distance / (eye[2] - z)
    return eye[0] + (x - eye[0]) * w, eye[1] + (y - eye[1]) * w, w


@njit(cache=True, forceinline=True)
def _from_grid(grid, u, v, w):
    """x, y, z, mm, of a point in the grid's coordinates."""
    if grid.vertical:
        return u, v, w
    eye = grid.cut_eye
    return eye[0] + (u - eye[0]) / w, eye[1] + (v - eye[1]) / w, eye[2] - grid.eye_distance / w


@njit(cache=True, forceinline=True)
def _row(vs, v, near):
    """Index of the interval of the descending lines ``vs`` that holds v, clipped to the grid, from one near by."""
    while near < len(vs) - 2 and vs[near + 1] > v:
        near += 1
    while near > 0 and vs[near] <= v:
        near -= 1
    return near


@njit(cache=True, forceinline=True)
def _column(us, u, near):
    """Index of the interval of the ascending lines ``us`` that holds u, clipped to the grid, from one near by."""
    while near < len(us) - 2 and us[near + 1] <= u:
        near += 1
    while near > 0 and us[near] > u:
        near -= 1
    return near


@njit(cache=True, forceinline=True)
def _entry(us, vs, start, end):
    """Share of a segment, given by u and v, at which it enters the grid's rectangle; 0 from within, 2 if never."""
    if us[0] <= start[0] <= us[-1] and vs[-1] <= start[1] <= vs[0]:
        return 0.0
    first, last = 0.0, 1.0
    for low, high, at, run in (
        (us[0], us[-1], start[0], end[0] - start[0]),
        (vs[-1], vs[0], start[1], end[1] - start[1]),
    ):
        if run == 0.0:
            if at < low or at > high:
                return 2.0
            continue
        a, b = (low - at) / run, (high - at) / run
        first, last = max(first, min(a, b)), min(last, max(a, b))
    return first if first <= last else 2.0
