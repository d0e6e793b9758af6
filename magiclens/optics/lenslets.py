"""Lenslets to second order: slopes, edge profiles and drifts of facet-patch transformations, before any is built."""

from __future__ import annotations

import math

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.kernels.threads import in_threads
from magiclens.optics.eyes import height_gradient, project, surface_point
from magiclens.optics.medium import Cut, Slab
from magiclens.optics.refraction import facet_normal, refract
from magiclens.optics.walls import Edges

_ROUNDS, _SETTLED, _FAR_OFF = 6, 0.005, 1.3
"""Iterations of slopes and heights, which depend on each other; share by which the last may change a height; how much
more than the relief the first may say of a lenslet that fits."""


@njit(cache=True)
def _slopes_at(centre, p, offset, m, cut, slab, out):
    """Unit normal (out[0:3]) and dh/du, dh/dv (out[3:5]) at p from a facet's centre, on the reference plane."""
    x, y = centre[0] + p[0], centre[1] + p[1]
    sx = centre[0] + offset[0] + m[0] * p[0] + m[1] * p[1]
    sy = centre[1] + offset[1] + m[1] * p[0] + m[2] * p[1]
    out[0], out[1], out[2] = facet_normal(cut.eye, (x, y, slab.depth), (sx, sy), slab)
    out[3], out[4] = height_gradient(cut, x, y, (out[0], out[1], out[2]), slab.depth)


@njit(cache=True)
def _lost(x, y, along_x, outward, normal, cut, eyes, slab):
    """Width of the strip that a wall takes from the eyes' pictures, mm per mm of step, on average over the eyes.

    ``max(outward (t_a / -t_z - lean), 0) + max(-outward (d_a / -d_z - lean), 0)`` for an eye's ray d, which is t in the
    slab, along the axis a across the wall; ``lean`` is that of the wall.

    The wall at (x, y) faces along x or y, ``outward`` = +-1, and the facet with this normal is the higher one. Rays in
    the slab that drift outward meet the wall from within; an eye that looks inward past the wall sees it from without.
    """
    a = 0 if along_x else 1
    here = x if along_x else y
    lean = 0.0 if cut.vertical else (here - cut.eye[a]) / (cut.eye[2] - slab.depth)
    total = 0.0
    for v in range(len(eyes)):
        dx, dy, dz = x - eyes[v, 0], y - eyes[v, 1], slab.depth - eyes[v, 2]
        q = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        t = refract(dx * q, dy * q, dz * q, normal[0], normal[1], normal[2], slab.ior)
        within = -t[a] / t[2] - lean if t[2] < 0.0 else 0.0
        without = (here - eyes[v, a]) / (eyes[v, 2] - slab.depth) - lean
        total += max(outward * within, 0.0) + max(-outward * without, 0.0)
    return total / len(eyes)


@njit(cache=True, nogil=True)
def _lenslet_edges_part(part, centres, candidates, pitch, cut, eyes, slab, edges):
    """Part of the facets, see ``lenslet_edges``; candidates: offsets and maps. edges: to fill."""
    (offsets, maps), (profiles, drifts) = candidates, edges
    labels, points, half = offsets.shape[1], profiles.shape[3], 0.5 * pitch
    s = np.zeros((5, 5))
    for f in range(part.first, part.end):
        cx, cy = centres[f, 0], centres[f, 1]
        for k in range(labels):
            for e in range(5):
                px = half if e == 0 else (-half if e == 2 else 0.0)
                py = half if e == 1 else (-half if e == 3 else 0.0)
                _slopes_at(centres[f], (px, py), offsets[f, k], maps[f, k], cut, slab, s[e])
            gu, gv = s[4, 3], s[4, 4]
            guu, gvv = (s[0, 3] - s[2, 3]) / pitch, (s[1, 4] - s[3, 4]) / pitch
            guv = 0.5 * ((s[1, 3] - s[3, 3]) + (s[0, 4] - s[2, 4])) / pitch
            mean = (guu + gvv) * pitch * pitch / 24.0
            for e in range(4):
                side, outward = e == 0 or e == 2, 1.0 if e < 2 else -1.0
                x, y = cx + (outward * half if side else 0.0), cy + (0.0 if side else outward * half)
                drifts[f, k, e, :] = _lost(x, y, side, outward, s[e], cut, eyes, slab)
                for q in range(points):
                    along = ((q + 0.5) / points - 0.5) * pitch
                    u = half if e == 0 else (-half if e == 2 else along)
                    v = half if e == 1 else (-half if e == 3 else along)
                    rise = gu * u + gv * v + 0.5 * (guu * u * u + gvv * v * v) + guv * u * v
                    profiles[f, k, e, q] = rise - mean


def lenslet_edges(
    centres: FloatArray,
    offsets: FloatArray,
    maps: FloatArray,
    pitch: float,
    cut: Cut,
    eyes: FloatArray,
    slab: Slab,
    points: int,
) -> Edges:
    """``Edges`` (F, K, 4, Q) float32 of lenslets that show the candidates' patches.

    ``h(u, v) = g . (u, v) + (u, v) H (u, v) / 2 - tr(H) pitch^2 / 24``: quadratic, with zero mean over the facet. The
    slopes g at the centre and H, their differences over the four edge midpoints, are taken on the reference plane.

    Args:
        centres: (F, 2) mm.
        offsets: (F, K, 2) mm, as in ``artifacts.Candidates``.
        maps: (F, K, 3) as in ``artifacts.Candidates``.
        pitch: side of a facet, mm.
        cut: how the top is cut, and the eye that the facets are designed for.
        eyes: (V, 3) of all views, mm; drifts are means over them and count walls that are seen from outside too.
        slab: the glass.
        points: Q, points per edge; drifts are equal along an edge.
    """
    shape = (*offsets.shape[:2], 4, points)
    edges = Edges(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
    in_threads(_lenslet_edges_part, len(offsets), centres, (offsets, maps), pitch, cut, eyes, slab, edges)
    return edges


@njit(cache=True, nogil=True)
def _shape_drifts_part(part, shapes, centres, cell, cut, eyes, slab, drifts):
    """Part of the facets, see ``shape_drifts``."""
    m = shapes.shape[1] - 1
    half = 0.5 * m * cell
    normal, eye = np.zeros(3), cut.eye
    for f in range(part.first, part.end):
        for e in range(4):
            side, outward = e == 0 or e == 2, 1.0 if e < 2 else -1.0
            for q in range(m):
                i = q if side else (0 if e == 1 else m - 1)
                j = (m - 1 if e == 0 else 0) if side else q
                tl, tr, bl, br = shapes[f, i, j], shapes[f, i, j + 1], shapes[f, i + 1, j], shapes[f, i + 1, j + 1]
                gu, gv = ((tr - tl) / cell, (tr - br) / cell) if e < 2 else ((br - bl) / cell, (tl - bl) / cell)
                along = (q + 0.5) * cell - half
                x = centres[f, 0] + (outward * half if side else along)
                y = centres[f, 1] + (-along if side else outward * half)
                lean = gu * (x - eye[0]) + gv * (y - eye[1])
                nz = 1.0 if cut.vertical else 1.0 - lean / (eye[2] - slab.depth)
                length = math.sqrt(gu * gu + gv * gv + nz * nz)
                normal[0], normal[1], normal[2] = -gu / length, -gv / length, nz / length
                drift = _lost(x, y, side, outward, normal, cut, eyes, slab)
                low = m - 1 - q if side else q
                drifts[f, e, low] += drift if low == 0 else 0.5 * drift
                drifts[f, e, low + 1] += drift if low + 1 == m else 0.5 * drift


def shape_drifts(
    shapes: FloatArray, centres: FloatArray, cell: float, cut: Cut, eyes: FloatArray, slab: Slab
) -> FloatArray:  # fmt: skip
    """(F, 4, k) float32: drifts at the vertices of the edges of facets that have been built, as in ``optics.walls``.

    A drift is a mean over the micro-facets at a vertex, whose normals are parallel to ``(-dh/du, -dh/dv, n_z)``, ``n_z
    = 1 - (dh/du, dh/dv) . (q - eye) / D``, for cells along the rays of an eye at the distance D from the plane.

    Args:
        shapes: (F, k, k) heights of vertices, mm.
        centres: (F, 2) mm.
        cell: distance between neighbouring vertices, mm.
        cut: how the top is cut.
        eyes: (V, 3) of all views, mm.
        slab: the glass.
    """
    drifts = np.zeros((len(shapes), 4, shapes.shape[1]), np.float32)
    in_threads(_shape_drifts_part, len(shapes), shapes, centres, cell, cut, eyes, slab, drifts)
    return drifts


@njit(cache=True, nogil=True)
def _centre_slopes_part(part, centres, offsets, eye, slab, out):
    """Part of the facets, see ``centre_slopes``."""
    for f in range(part.first, part.end):
        x, y = centres[f, 0], centres[f, 1]
        for k in range(offsets.shape[1]):
            source = (x + offsets[f, k, 0], y + offsets[f, k, 1])
            nx, ny, nz = facet_normal(eye, (x, y, slab.depth), source, slab)
            out[f, k, 0], out[f, k, 1] = nx / -nz, ny / -nz


def centre_slopes(centres: FloatArray, offsets: FloatArray, eye: FloatArray, slab: Slab) -> FloatArray:
    """(F, K, 2) slopes dz/dx and dz/dy at the facets' centres that show patches to an eye.

    Args:
        centres: (F, 2) mm.
        offsets: (F, K, 2) of the patches, mm.
        eye: (3,) mm.
        slab: the glass.
    """
    out = np.zeros(offsets.shape)
    in_threads(_centre_slopes_part, len(offsets), centres, offsets, eye, slab, out)
    return out


@njit(cache=True)
def facet_slope(u, v, h, centre, offset, m, optics):
    """dh/du and dh/dv at a point of the surface of a facet that shows a patch, and whether the slope limit was hit.

    The reference eye sees the point at q of the reference plane, and shall see ``c + R + M (q - c)`` of the source
    there; that gives the normal, ``optics.refraction.facet_normal``, and the normal gives the slopes. A normal with
    ``n_z < cos_limit`` is turned upright until it meets the limit.

    Args:
        u: of the point on the reference plane, mm.
        v: the same along +y, mm.
        h: its height, mm.
        centre: (2,) c of the facet, mm.
        offset: (2,) R of the facet's patch, mm.
        m: (3,) M of the facet's patch as (xx, xy, yy).
        optics: an ``optics.medium.Optics``.

    Returns:
        dh/du, dh/dv, and whether the slope was held at its limit.
    """
    point = surface_point(optics, u, v, h, optics.depth)
    # the eye sees the surface point where its ray crosses the reference plane: that is the point of the tile
    x, y = project(optics.eye, point, optics.depth)
    px, py = x - centre[0], y - centre[1]
    sx = centre[0] + offset[0] + m[0] * px + m[1] * py
    sy = centre[1] + offset[1] + m[1] * px + m[2] * py
    nx, ny, nz = facet_normal(optics.eye, point, (sx, sy), optics)
    cos_limit = optics.cos_limit
    clamped = nz < cos_limit
    if clamped:
        side = math.sqrt((1.0 - cos_limit * cos_limit) / max(nx * nx + ny * ny, 1e-30))
        nx, ny, nz = nx * side, ny * side, cos_limit
    gu, gv = height_gradient(optics, u, v, (nx, ny, nz), optics.depth)
    return gu, gv, clamped


@njit(cache=True)
def tallest(centre, offset, m, half, optics):
    """How far a lenslet that shows a patch rises or falls from its mean, mm; of one that is much too tall, a guess.

    Slopes at nine points, three along either side, are integrated as the quadratic through each three. Where the
    surface is lower, it must be steeper, so slopes and heights are iterated. Arguments are those of ``facet_slope``;
    half: half the pitch, mm.
    """
    tall = 0.0
    along_u, along_v, heights, rises = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    share = half / 12.0
    for _ in range(_ROUNDS):
        for a in range(3):
            for b in range(3):
                u, v = centre[0] + (b - 1) * half, centre[1] + (a - 1) * half
                gu, gv, _clamped = facet_slope(u, v, heights[a, b], centre, offset, m, optics)
                along_u[a, b], along_v[a, b] = gu * share, gv * share
        # from the middle of three points to one of the others: 5/12, 8/12 and -1/12 of the slopes there
        for a in range(3):
            for b in range(0, 3, 2):
                rises[a, b] = (b - 1) * (5.0 * along_u[a, b] + 8.0 * along_u[a, 1] - along_u[a, 2 - b])
        for a in range(0, 3, 2):
            up = (a - 1) * (5.0 * along_v[a, 1] + 8.0 * along_v[1, 1] - along_v[2 - a, 1])
            rises[a, 1] = up
            for b in range(0, 3, 2):
                side = (a - 1) * (5.0 * along_v[a, b] + 8.0 * along_v[1, b] - along_v[2 - a, b])
                # both ways from the centre to a corner, over the middle of either side
                rises[a, b] = 0.5 * (up + rises[a, b] + rises[1, b] + side)
        corners = rises[0, 0] + rises[0, 2] + rises[2, 0] + rises[2, 2]
        mean = (corners + 4.0 * (rises[0, 1] + rises[1, 0] + rises[1, 2] + rises[2, 1])) / 36.0  # Simpson's rule
        last, tall = tall, 0.0
        for a in range(3):
            for b in range(3):
                heights[a, b] = rises[a, b] - mean
                if not abs(heights[a, b]) <= tall:  # nan wins
                    tall = abs(heights[a, b])
        if tall > _FAR_OFF * optics.relief or abs(tall - last) < _SETTLED * tall:
            break
    return tall
