"""Continuous polishing of candidates: the offset and the symmetric map, by Levenberg-Marquardt.

The search tries offsets and maps on a lattice; a patch that almost fits is then moved, scaled and sheared until its
edges fall on the tile's edges. The map stays symmetric, so that a smooth lenslet can still show it.
"""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.cholesky import solve_damped
from magiclens.kernels.compiler import njit
from magiclens.kernels.lanes import LANES, lanes_at, no_lanes, sum_of_lanes
from magiclens.kernels.resuming import blocks, resumable
from magiclens.kernels.threads import in_threads
from magiclens.kernels.uncounted import uncounted
from magiclens.matching.look_up_kernels import look, places_for
from magiclens.matching.reachability_kernels import distance_term, reachable
from magiclens.matching.tuples import Found, Levels, PolishingRule, Tiles, Window
from magiclens.optics.medium import Optics

PARAMETERS = 5
"""How many parameters are polished: offset x, y and map xx, xy, yy."""
PIXEL_WIDTHS = 1.4
"""The box over which a source is averaged is narrower than so many of the pixels that a tile sees there."""


@njit(cache=True)
def _places_of(tiles):
    """The ``Places`` of a tile: one for each pixel."""
    pixels = tiles.values.shape[1]
    found, px = places_for(pixels * pixels), tiles.pitch / pixels
    for k in range(len(found.u)):
        found.u[k], found.v[k] = (k % pixels - 0.5 * (pixels - 1)) * px, (k // pixels - 0.5 * (pixels - 1)) * px
    return found


# not plain fastmath, which takes infinity, a limit that there is not, for impossible
@njit(cache=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def _normal_equations(f, p, seen, limit, jtj, jtr):
    """Mean squared difference of a tile and the patch that parameters p show; fills J^T J (lower half) and J^T r.

    ``r = source(c + R + M u) - tile(u)``. A residual's derivatives are the source's slopes (gx, gy), times u and v for
    the map: sums over gx^2, gx gy, gy^2 and gx r, gy r, weighted by powers of u along a row, have all of them.

    A difference that turns out to be larger than the limit is infinity, and nothing is filled in.
    """
    tiles, levels, per_mm, places = seen
    _, pixels, _, channels = tiles.values.shape
    level, footprint = 0, tiles.pitch / pixels * math.sqrt(abs(p[2] * p[4] - p[3] * p[3]))
    while level + 1 < len(levels.widths) and levels.widths[level + 1] < PIXEL_WIDTHS * footprint:
        level += 1
    shape = levels.images.shape[1:]
    look(places, (tiles.centres[f, 0] + p[0], tiles.centres[f, 1] + p[1]), (p[2], p[3], p[4]), per_mm, shape)
    start, size, one = level * shape[0] * shape[1] * channels, channels * pixels * pixels, np.uint64(channels)
    down = np.uint64(shape[1] * channels)
    jtj[:], jtr[:], total, most = 0.0, 0.0, np.float32(0.0), np.float32(limit * size)
    for c in range(0, channels, LANES):
        squares, counted = no_lanes(), channels - c
        r0 = r1 = r2 = r3 = r4 = no_lanes()
        a00 = a10 = a11 = a20 = a21 = a22 = a30 = a31 = a32 = a33 = a40 = a41 = a42 = a43 = a44 = no_lanes()
        for row in range(0, pixels * pixels, pixels):
            xx0 = xx1 = xx2 = xy0 = xy1 = xy2 = yy0 = yy1 = yy2 = xr0 = xr1 = yr0 = yr1 = no_lanes()
            for k in range(np.uint64(row), np.uint64(row + pixels)):
                fx, fy, u = places.right[k], places.below[k], np.float32(places.u[k])
                n = np.uint64(start + places.first[k] + c)
                tl, tr = lanes_at(levels.images, n), lanes_at(levels.images, n + one)
                bl, br = lanes_at(levels.images, n + down), lanes_at(levels.images, n + down + one)
                top, low = tl + (tr - tl) * fx, bl + (br - bl) * fx
                gx, gy = (tr - tl) + ((br - bl) - (tr - tl)) * fy, low - top
                r = top + gy * fy - lanes_at(tiles.values, np.uint64(f * size + c) + k * one)
                squares = squares + r * r
                gxu, gyu = gx * u, gy * u
                xx0, xx1, xx2 = xx0 + gx * gx, xx1 + gx * gxu, xx2 + gxu * gxu
                xy0, xy1, xy2 = xy0 + gx * gy, xy1 + gx * gyu, xy2 + gxu * gyu
                yy0, yy1, yy2 = yy0 + gy * gy, yy1 + gy * gyu, yy2 + gyu * gyu
                xr0, xr1, yr0, yr1 = xr0 + gx * r, xr1 + gxu * r, yr0 + gy * r, yr1 + gyu * r
            if total + sum_of_lanes(squares, counted) > most:
                return np.inf
            v = np.float32(places.v[row])
            r0, r1, r2, r3, r4 = r0 + xr0, r1 + yr0, r2 + xr1, r3 + (xr0 * v + yr1), r4 + yr0 * v
            a00, a10, a11 = a00 + xx0, a10 + xy0, a11 + yy0
            a20, a21, a22 = a20 + xx1, a21 + xy1, a22 + xx2
            a30, a31, a32 = a30 + (xx0 * v + xy1), a31 + (xy0 * v + yy1), a32 + (xx1 * v + xy2)
            a33 = a33 + ((xx0 * v + (xy1 + xy1)) * v + yy2)
            a40, a41, a42 = a40 + xy0 * v, a41 + yy0 * v, a42 + xy1 * v
            a43, a44 = a43 + (xy0 * v + yy1) * v, a44 + yy0 * v * v
        total += sum_of_lanes(squares, counted)
        jtr[0] += sum_of_lanes(r0, counted)
        jtr[1] += sum_of_lanes(r1, counted)
        jtr[2] += sum_of_lanes(r2, counted)
        jtr[3] += sum_of_lanes(r3, counted)
        jtr[4] += sum_of_lanes(r4, counted)
        jtj[0, 0] += sum_of_lanes(a00, counted)
        jtj[1, 0] += sum_of_lanes(a10, counted)
        jtj[1, 1] += sum_of_lanes(a11, counted)
        jtj[2, 0] += sum_of_lanes(a20, counted)
        jtj[2, 1] += sum_of_lanes(a21, counted)
        jtj[2, 2] += sum_of_lanes(a22, counted)
        jtj[3, 0] += sum_of_lanes(a30, counted)
        jtj[3, 1] += sum_of_lanes(a31, counted)
        jtj[3, 2] += sum_of_lanes(a32, counted)
        jtj[3, 3] += sum_of_lanes(a33, counted)
        jtj[4, 0] += sum_of_lanes(a40, counted)
        jtj[4, 1] += sum_of_lanes(a41, counted)
        jtj[4, 2] += sum_of_lanes(a42, counted)
        jtj[4, 3] += sum_of_lanes(a43, counted)
        jtj[4, 4] += sum_of_lanes(a44, counted)
    return total / size


# element by element: numba compiles an assignment of slices for seconds, with the texts of its errors
@njit(cache=True)
def read_candidate(found, f, k, p):
    """Fill p (5,) with the parameters of candidate k of facet f."""
    p[0], p[1] = found.offsets[f, k, 0], found.offsets[f, k, 1]
    p[2], p[3], p[4] = found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2]


@njit(cache=True)
def write_candidate(p, found, f, k):
    """Give candidate k of facet f the parameters p (5,)."""
    found.offsets[f, k, 0], found.offsets[f, k, 1] = p[0], p[1]
    found.maps[f, k, 0], found.maps[f, k, 1], found.maps[f, k, 2] = p[2], p[3], p[4]


@njit(cache=True)
def polishing_step(jtj, jtr, damping, per_mm, isotropic, room, step):
    """Fill step (5,) with a damped Gauss-Newton step of the parameters, mm.

    Args:
        jtj: (5, 5), its lower half, of derivatives per source pixel.
        jtr: (5,) likewise.
        damping: relative to the diagonal.
        per_mm: source pixels per mm.
        isotropic: whether only the offset and one scale may change.
        room: (5, 5) float64, overwritten.
        step: to fill.
    """
    n = 3 if isotropic else PARAMETERS
    for m in range(n):
        step[m] = -jtr[m] * per_mm
        for k in range(m + 1):
            room[m, k] = jtj[m, k] * per_mm * per_mm
    if isotropic:  # the scale is xx and yy at once
        step[2] -= jtr[4] * per_mm
        room[2, 0] += jtj[4, 0] * per_mm * per_mm
        room[2, 1] += jtj[4, 1] * per_mm * per_mm
        room[2, 2] += (2 * jtj[4, 2] + jtj[4, 4]) * per_mm * per_mm
    solve_damped(room, step, n, damping)
    if isotropic:
        step[3], step[4] = 0.0, step[2]


@njit(cache=True)
def _inside(q, centre, half, edge, window, isotropic):
    """Whether the patch of parameters q lies in the window and on the source, and its map may be so."""
    spread_x = half * (abs(q[2]) + abs(q[3]))
    spread_y = half * (abs(q[3]) + abs(q[4]))
    return (
        not (isotropic and q[2] <= 0.0) and abs(q[0]) <= window.half and abs(q[1]) <= window.half
        and abs(centre[0] + q[0]) + spread_x <= edge and abs(centre[1] + q[1]) + spread_y <= edge
    )  # fmt: skip


@njit(cache=True)
def _polish_facet(f, tiles, levels, per_mm, window, rule, optics, found):
    """Polish the candidates of facet f, see ``polish``."""
    half, edge = 0.5 * tiles.pitch, 0.5 * levels.images.shape[2] / per_mm
    tiles, levels, found = uncounted(tiles), uncounted(levels), uncounted(found)
    centre, seen = (tiles.centres[f, 0], tiles.centres[f, 1]), (tiles, levels, per_mm, _places_of(tiles))
    jtj, jtr = np.zeros((2, PARAMETERS, PARAMETERS)), np.zeros((2, PARAMETERS))
    room, step = np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS)
    p, q, now = np.zeros(PARAMETERS), np.zeros(PARAMETERS), 0
    for k in range(found.errors.shape[1]):
        if not np.isfinite(found.errors[f, k]):
            continue
        read_candidate(found, f, k, p)
        best, damping = _normal_equations(f, p, seen, np.inf, jtj[now], jtr[now]), 1e-2
        for _ in range(rule.iterations if k < rule.most else 0):
            polishing_step(jtj[now], jtr[now], damping, per_mm, rule.isotropic, room, step)
            for a in range(PARAMETERS):
                q[a] = p[a] + step[a]
            other, trial = 1 - now, np.inf
            if _inside(q, centre, half, edge, window, rule.isotropic):
                trial = _normal_equations(f, q, seen, best, jtj[other], jtr[other])
            # whether refraction can do it is asked last, as it takes long and is seldom denied
            if trial < best and reachable(centre, (q[0], q[1]), (q[2], q[3], q[4]), half, optics):
                gain, best, now = best - trial, trial, other
                p, q = q, p
                damping *= 0.3
                if gain < 1e-3 * best:
                    break
            else:
                damping *= 6.0
                if damping > 1e4:
                    break
        found.errors[f, k] = best + distance_term(p[0], p[1], window)
        write_candidate(p, found, f, k)


@njit(cache=True, nogil=True)
def _polish_part(part, tiles, levels, per_mm, window, rule, optics, found):
    """Part of the facets, see ``polish``."""
    for f in range(part.first, part.end):
        _polish_facet(f, tiles, levels, per_mm, window, rule, optics, found)


def polish(
    tiles: Tiles, levels: Levels, per_mm: float, window: Window, rule: PolishingRule, optics: Optics, found: Found
) -> None:  # fmt: skip
    """Polish candidates in place by Levenberg-Marquardt; ``mean over pixels of (tile - patch)^2`` is minimised.

    All candidates, polished or not, get their error at the sub-pixel position, so that they can be compared.

    Args:
        tiles: ``Tiles`` (F, P, P, C), with room for lanes.
        levels: ``Levels`` (L, H, W, C) of the source, with room for lanes.
        per_mm: source pixels per mm.
        window: the search window, which candidates do not leave.
        rule: how many are polished, and how.
        optics: ``Optics`` in the image frame.
        found: the candidates, updated in place.
    """
    for block in resumable(blocks(len(tiles.centres)), *found):
        in_threads(_polish_part, block, tiles, levels, per_mm, window, rule, optics, found)


@njit(cache=True, nogil=True)
def _drop_unreachable_part(part, centres, half, optics, found):
    """Part of the facets, see ``drop_unreachable``."""
    for f in range(part.first, part.end):
        centre = (centres[f, 0], centres[f, 1])
        for k in range(found.errors.shape[1]):
            offset, m = (found.offsets[f, k, 0], found.offsets[f, k, 1]), found.maps[f, k]
            if np.isfinite(found.errors[f, k]) and not reachable(centre, offset, (m[0], m[1], m[2]), half, optics):
                found.errors[f, k] = np.inf


def drop_unreachable(centres: FloatArray, half: float, optics: Optics, found: Found) -> None:
    """Set the errors of candidates to infinity, in place, that facets cannot show.

    Args:
        centres: (F, 2) of the facets, mm.
        half: half the pitch, mm.
        optics: ``Optics`` in the image frame.
        found: the candidates.
    """
    in_threads(_drop_unreachable_part, len(centres), centres, half, optics, found)
