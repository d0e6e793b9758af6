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
from magiclens.kernels.resuming import blocks, resumable
from magiclens.kernels.sampling import clamped_cell
from magiclens.kernels.threads import in_threads
from magiclens.matching.reachability_kernels import distance_term, reachable
from magiclens.matching.tuples import Found, Levels, PolishingRule, Tiles, Window
from magiclens.optics.medium import Optics

PARAMETERS = 5
"""How many parameters are polished: offset x, y and map xx, xy, yy."""


@njit(cache=True, fastmath=True)
def _normal_equations(tile, levels, per_mm, centre, px, p, jtj, jtr):
    """Mean squared difference of a tile and the patch that parameters p show; fills J^T J (lower half) and J^T r.

    ``r = source(c + R + M u) - tile(u)``. A residual's derivatives are the source's slopes (gx, gy), times u and v for
    the map: sums over gx^2, gx gy, gy^2 and gx r, gy r, weighted by powers of u along a row, have all of them.
    """
    pixels, _, channels = tile.shape
    seen = px * math.sqrt(abs(p[2] * p[4] - p[3] * p[3]))
    level = 0
    while level + 1 < len(levels.widths) and levels.widths[level + 1] < 1.4 * seen:
        level += 1
    image = levels.images[level]
    rows, columns = image.shape[0], image.shape[1]
    half_w, half_h = 0.5 * columns - 0.5, 0.5 * rows - 0.5
    jtj[:], jtr[:], total = 0.0, 0.0, 0.0
    for ky in range(pixels):
        v = (ky - 0.5 * (pixels - 1)) * px
        xx0 = xx1 = xx2 = xy0 = xy1 = xy2 = yy0 = yy1 = yy2 = xr0 = xr1 = yr0 = yr1 = np.float32(0.0)
        for kx in range(pixels):
            u = (kx - 0.5 * (pixels - 1)) * px
            x = (centre[0] + p[0] + p[2] * u + p[3] * v) * per_mm + half_w
            y = (centre[1] + p[1] + p[3] * u + p[4] * v) * per_mm + half_h
            j, i, dx, dy = clamped_cell(x, y, columns, rows)
            fx, fy, u = np.float32(dx), np.float32(dy), np.float32(u)
            xx = xy = yy = xr = yr = np.float32(0.0)
            for c in range(channels):
                tl, tr, bl, br = image[i, j, c], image[i, j + 1, c], image[i + 1, j, c], image[i + 1, j + 1, c]
                top, low = tl + (tr - tl) * fx, bl + (br - bl) * fx
                gx, gy = (tr - tl) + ((br - bl) - (tr - tl)) * fy, low - top
                r = top + gy * fy - tile[ky, kx, c]
                xx += gx * gx
                xy += gx * gy
                yy += gy * gy
                xr += gx * r
                yr += gy * r
                total += r * r
            xx0, xx1, xx2 = xx0 + xx, xx1 + xx * u, xx2 + xx * u * u
            xy0, xy1, xy2 = xy0 + xy, xy1 + xy * u, xy2 + xy * u * u
            yy0, yy1, yy2 = yy0 + yy, yy1 + yy * u, yy2 + yy * u * u
            xr0, xr1, yr0, yr1 = xr0 + xr, xr1 + xr * u, yr0 + yr, yr1 + yr * u
        jtr[0] += xr0
        jtr[1] += yr0
        jtr[2] += xr1
        jtr[3] += xr0 * v + yr1
        jtr[4] += yr0 * v
        jtj[0, 0] += xx0
        jtj[1, 0] += xy0
        jtj[1, 1] += yy0
        jtj[2, 0] += xx1
        jtj[2, 1] += xy1
        jtj[2, 2] += xx2
        jtj[3, 0] += xx0 * v + xy1
        jtj[3, 1] += xy0 * v + yy1
        jtj[3, 2] += xx1 * v + xy2
        jtj[3, 3] += xx0 * v * v + 2 * xy1 * v + yy2
        jtj[4, 0] += xy0 * v
        jtj[4, 1] += yy0 * v
        jtj[4, 2] += xy1 * v
        jtj[4, 3] += xy0 * v * v + yy1 * v
        jtj[4, 4] += yy0 * v * v
    return total / (channels * pixels * pixels)


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
def polishing_step(jtj, jtr, damping, per_mm, isotropic, step):
    """Fill step (5,) with a damped Gauss-Newton step of the parameters, mm.

    Args:
        jtj: (5, 5), its lower half, of derivatives per source pixel.
        jtr: (5,) likewise.
        damping: relative to the diagonal.
        per_mm: source pixels per mm.
        isotropic: whether only the offset and one scale may change.
        step: to fill.
    """
    n = 3 if isotropic else PARAMETERS
    a = np.zeros((n, n))
    b = np.zeros(n)
    to = (0, 1, 2, -1, 2) if isotropic else (0, 1, 2, 3, 4)
    for m in range(PARAMETERS):
        if to[m] < 0:
            continue
        b[to[m]] -= jtr[m] * per_mm
        for k in range(PARAMETERS):
            if to[k] >= 0:
                a[to[m], to[k]] += jtj[max(m, k), min(m, k)] * per_mm * per_mm
    solve_damped(a, b, damping)
    for m in range(PARAMETERS):
        step[m] = b[to[m]] if to[m] >= 0 else 0.0


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
    px, half = tiles.pitch / tiles.values.shape[1], 0.5 * tiles.pitch
    edge = 0.5 * levels.images.shape[2] / per_mm
    jtj, jtr = np.zeros((2, PARAMETERS, PARAMETERS)), np.zeros((2, PARAMETERS))
    step, now = np.zeros(PARAMETERS), 0
    p, q = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    tile, centre = tiles.values[f], (tiles.centres[f, 0], tiles.centres[f, 1])
    for k in range(found.errors.shape[1]):
        if not np.isfinite(found.errors[f, k]):
            continue
        read_candidate(found, f, k, p)
        damping = 1e-2
        best = _normal_equations(tile, levels, per_mm, centre, px, p, jtj[now], jtr[now])
        for _ in range(rule.iterations if k < rule.most else 0):
            polishing_step(jtj[now], jtr[now], damping, per_mm, rule.isotropic, step)
            for a in range(PARAMETERS):
                q[a] = p[a] + step[a]
            other, trial = 1 - now, np.inf
            if _inside(q, centre, half, edge, window, rule.isotropic):
                trial = _normal_equations(tile, levels, per_mm, centre, px, q, jtj[other], jtr[other])
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
        tiles: ``Tiles`` (F, P, P, C).
        levels: ``Levels`` (L, H, W, C) of the source.
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
