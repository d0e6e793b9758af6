"""What other eyes see through a facet that was designed for one: position and local map, by exact refraction (4.6).

A lenslet is given by the patch that the *reference eye* shall see: ``s(q) = c + R + M (q - c)`` where its ray crosses
the reference plane at q, for the facet centred at c. That fixes the normal at every point, and with it what every other
eye sees. Points are named by q, whether the cells are cut along this eye's rays or vertically. Horizontal axes may be
mirrored (images run y down): Snell's law does not change.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.kernels.compiler import njit
from magiclens.optics.medium import Cut
from magiclens.optics.refraction import facet_normal, refract

_STEP_MM = 0.02
"""Step of the finite differences, mm."""


class FirstOrder(NamedTuple):
    """What eyes see through facets, to first order; one row per eye or facet, float64, mm.

    A lenslet with map M shows an eye the source point ``landing + (by_facet + by_source M) p`` at ``position +
    position_by_facet p`` of its picture, where p is a point's distance from the facet's centre as the reference eye
    sees it. Within a flat micro-facet the source point moves by ``flat_by_facet p`` instead.

    Parallel kernels must not assign to its arrays themselves, only through functions: numba takes what is written to a
    tuple's field for unused, and drops it.

    Args:
        landing: (R, 2) source point that the eye sees at the facet's centre.
        by_facet: (R, 2, 2) derivative of the landing point along the facet, its wanted source point held.
        by_source: (R, 2, 2) derivative of the landing point along the wanted source point.
        position: (R, 2) where on the reference plane the eye sees the facet's centre.
        position_by_facet: (R, 2, 2) derivative of the position along the facet.
        flat_by_facet: (R, 2, 2) derivative of the landing point along a facet that is flat.
    """

    landing: FloatArray
    by_facet: FloatArray
    by_source: FloatArray
    position: FloatArray
    position_by_facet: FloatArray
    flat_by_facet: FloatArray


@njit(cache=True)
def unknown_first_order(rows):
    """A ``FirstOrder`` of so many rows, all nan."""
    return FirstOrder(
        np.full((rows, 2), np.nan),
        np.full((rows, 2, 2), np.nan),
        np.full((rows, 2, 2), np.nan),
        np.full((rows, 2), np.nan),
        np.full((rows, 2, 2), np.nan),
        np.full((rows, 2, 2), np.nan),
    )


@njit(cache=True)
def surface_point(cut, u, v, height, depth):
    """x, y, z of a point of the top, mm: ``eye + exp(-h / D) (q - eye)``, D being the eye's distance from the plane.

    Args:
        cut: how the top is cut; with vertical cells the point is at (u, v, depth + h).
        u, v: the point q of the reference plane that it is named by, mm.
        height: h, see ``HeightField``, mm.
        depth: from the reference plane to the flat bottom, mm.
    """
    if cut.vertical:
        return u, v, depth + height
    eye = cut.eye
    far = eye[2] - depth
    rho = math.exp(-height / far)
    return eye[0] + rho * (u - eye[0]), eye[1] + rho * (v - eye[1]), eye[2] - rho * far


@njit(cache=True)
def height_gradient(cut, u, v, normal, depth):
    """dh/du and dh/dv of the top's heights: ``N_uv / (N . d)``, d being the eye ray, 1 long along -z.

    Args:
        cut: how the top is cut.
        u, v: the point of the reference plane, mm.
        normal: the unit normal there.
        depth: from the reference plane to the flat bottom, mm.
    """
    nx, ny, nz = normal
    lean = 0.0 if cut.vertical else (nx * (u - cut.eye[0]) + ny * (v - cut.eye[1])) / (cut.eye[2] - depth)
    return nx / (lean - nz), ny / (lean - nz)


@njit(cache=True)
def project(eye, point, depth):
    """x, y of the point of the reference plane at which an eye sees a point of the top, mm.

    Args:
        eye: x, y, z, mm.
        point: x, y, z, mm.
        depth: from the reference plane to the flat bottom, mm.
    """
    x, y, z = point
    t = (eye[2] - depth) / (eye[2] - z)
    return eye[0] + (x - eye[0]) * t, eye[1] + (y - eye[1]) * t


@njit(cache=True)
def land(eye, point, normal, slab):
    """Where an eye's ray through a point of the top, with this unit normal, meets the source.

    ``landing = point + t_xy (gap ior / cos_out - z / t_z)`` with the unit direction t inside the slab and the angle of
    the ray in the gap, ``cos_out^2 = 1 - ior^2 (1 - t_z^2)``.

    Args:
        eye: x, y, z, mm.
        point: x, y, z of the point of the top, mm.
        normal: the unit normal there.
        slab: the glass.

    Returns:
        x, y of the landing point, mm, and whether the ray arrives.
    """
    x, y, z = point
    nx, ny, nz = normal
    dx, dy, dz = x - eye[0], y - eye[1], z - eye[2]
    q = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * q, dy * q, dz * q
    if dx * nx + dy * ny + dz * nz >= 0.0:
        return 0.0, 0.0, False
    tx, ty, tz = refract(dx, dy, dz, nx, ny, nz, slab.ior)
    out = 1.0 - slab.ior * slab.ior * (1.0 - tz * tz)
    if tz >= 0.0 or out <= 0.0:
        return 0.0, 0.0, False
    reach = slab.gap * slab.ior / math.sqrt(out) - z / tz
    return x + tx * reach, y + ty * reach, True


@njit(cache=True)
def _seen(eye, rays, x, y, height, wanted, slab):
    """Landing point of the eye's ray where the facet shows ``wanted`` to the reference eye, and the normal there."""
    point = surface_point(rays, x, y, height, slab.depth)
    normal = facet_normal(rays.eye, point, wanted, slab)
    lx, ly, ok = land(eye, point, normal, slab)
    return lx, ly, normal, ok


@njit(cache=True)
def linearise(eye, facet, offset, reference_eye, slab, whole, out, row):
    """Fill a row of a ``FirstOrder`` with what an eye sees through a facet, by exact rays and finite differences.

    ``d landing / dp`` with ``s(p) = c + R`` held gives ``by_facet``, ``d landing / ds`` gives ``by_source``.

    Args:
        eye: (3,) the eye that looks, mm.
        facet: x and y of the facet's centre and its height above the reference plane, mm.
        offset: x and y of the patch that the facet shows to the reference eye, from the facet's centre, mm.
        reference_eye: (3,) the eye that the facet is designed for, mm.
        slab: the glass.
        whole: False leaves out ``position``, ``position_by_facet`` and ``flat_by_facet``.
        out: the ``FirstOrder`` to fill.
        row: the row of it.

    Returns:
        False where the light is reflected totally; the row is then undefined.
    """
    cx, cy, height = facet
    rays = Cut(reference_eye, False)
    sx, sy = cx + offset[0], cy + offset[1]
    lx, ly, normal, ok = _seen(eye, rays, cx, cy, height, (sx, sy), slab)
    if not ok:
        return False
    gx, gy = height_gradient(rays, cx, cy, normal, slab.depth)
    out.landing[row, 0], out.landing[row, 1] = lx, ly
    px, py = 0.0, 0.0
    if whole:
        px, py = project(eye, surface_point(rays, cx, cy, height, slab.depth), slab.depth)
        out.position[row, 0], out.position[row, 1] = px, py
    for axis in range(2):
        dx, dy = (_STEP_MM, 0.0) if axis == 0 else (0.0, _STEP_MM)
        h = height + gx * dx + gy * dy
        ax, ay, _, arrives = _seen(eye, rays, cx + dx, cy + dy, h, (sx, sy), slab)
        bx, by, _, also = _seen(eye, rays, cx, cy, height, (sx + dx, sy + dy), slab)
        if not (arrives and also):
            return False
        out.by_facet[row, 0, axis], out.by_facet[row, 1, axis] = (ax - lx) / _STEP_MM, (ay - ly) / _STEP_MM
        out.by_source[row, 0, axis], out.by_source[row, 1, axis] = (bx - lx) / _STEP_MM, (by - ly) / _STEP_MM
        if whole:
            beside = surface_point(rays, cx + dx, cy + dy, h, slab.depth)
            ux, uy = project(eye, beside, slab.depth)
            out.position_by_facet[row, 0, axis] = (ux - px) / _STEP_MM
            out.position_by_facet[row, 1, axis] = (uy - py) / _STEP_MM
            fx, fy, flat = land(eye, beside, normal, slab)
            if not flat:
                return False
            out.flat_by_facet[row, 0, axis] = (fx - lx) / _STEP_MM
            out.flat_by_facet[row, 1, axis] = (fy - ly) / _STEP_MM
    return True


@njit(cache=True)
def shift(seen, row, step):
    """Move the wanted source point by a small step along x: ``landing += by_source x``; derivatives stay.

    Args:
        seen: a ``FirstOrder``, changed in place.
        row: of it.
        step: mm.
    """
    seen.landing[row, 0] += seen.by_source[row, 0, 0] * step
    seen.landing[row, 1] += seen.by_source[row, 1, 0] * step


@njit(cache=True)
def local_map(seen, row, m, out):
    """The map of the patch that an eye sees through a lenslet: ``by_facet + by_source M``.

    Args:
        seen: a ``FirstOrder``.
        row: of it.
        m: the map M that the lenslet has for the reference eye, (xx, xy, yy).
        out: (4,) to fill, row-major.
    """
    for axis in range(2):
        a, b = seen.by_source[row, axis, 0], seen.by_source[row, axis, 1]
        out[2 * axis] = seen.by_facet[row, axis, 0] + a * m[0] + b * m[1]
        out[2 * axis + 1] = seen.by_facet[row, axis, 1] + a * m[1] + b * m[2]


@njit(cache=True)
def linearised(eye, reference_eye, centres, heights, offsets, slab):
    """What an eye sees through every facet, a ``FirstOrder`` of F rows, nan where light is reflected totally.

    Args:
        eye: (3,) the eye that looks, mm.
        reference_eye: (3,) the eye that the facets are designed for, mm.
        centres: (F, 2) mm.
        heights: (F,) of the centres above the reference plane, mm.
        offsets: (F, 2) of the patches, mm.
        slab: the glass.
    """
    out, one = unknown_first_order(len(centres)), unknown_first_order(1)
    for f in range(len(centres)):
        facet = (centres[f, 0], centres[f, 1], heights[f])
        if linearise(eye, facet, (offsets[f, 0], offsets[f, 1]), reference_eye, slab, True, one, 0):
            out.landing[f], out.position[f] = one.landing[0], one.position[0]
            out.by_facet[f], out.by_source[f] = one.by_facet[0], one.by_source[0]
            out.position_by_facet[f], out.flat_by_facet[f] = one.position_by_facet[0], one.flat_by_facet[0]
    return out
