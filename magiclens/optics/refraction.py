"""Snell's law, Fresnel's transmission and the normal that a facet needs (4.3).

Directions are unit vectors along the light path followed from the eye: down through the top, down through the slab.
Normals point up (+z), out of the slab.
"""

from __future__ import annotations

import math

from magiclens.kernels.compiler import njit


@njit(cache=True)
def refract(dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, eta: float):
    """Direction after a surface, by Snell's law; (0, 0, 0) on total internal reflection.

    Args:
        dx, dy, dz: unit direction of travel.
        nx, ny, nz: unit normal on the side that the ray comes from.
        eta: index behind the surface over index in front of it.
    """
    cos_i = -(dx * nx + dy * ny + dz * nz)
    k = 1.0 - (1.0 - cos_i * cos_i) / (eta * eta)
    if k <= 0.0:
        return 0.0, 0.0, 0.0
    b = cos_i / eta - math.sqrt(k)
    return dx / eta + b * nx, dy / eta + b * ny, dz / eta + b * nz


@njit(cache=True)
def transmittance(cos_i: float, eta: float) -> float:
    """Fresnel transmittance of unpolarised light, 0 on total internal reflection.

    Args:
        cos_i: cosine of the angle of incidence, > 0.
        eta: index behind the surface over index in front of it.
    """
    k = 1.0 - (1.0 - cos_i * cos_i) / (eta * eta)
    if k <= 0.0:
        return 0.0
    cos_t = math.sqrt(k)
    s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return 1.0 - 0.5 * (s * s + p * p)


@njit(cache=True)
def sine_in_slab(distance: float, depth: float, gap: float, ior: float) -> float:
    """Sine of the angle inside the slab of the ray that ends ``distance`` sideways of where it starts.

    Newton's method on s: ``depth * s / sqrt(1 - s^2) + gap * n s / sqrt(1 - n^2 s^2) = distance``; the left side is
    convex and increasing, so Newton's method descends monotonically from the first iterate on.

    Args:
        distance: sideways, mm.
        depth: how far down the ray runs through the slab, mm.
        gap: air below the flat bottom, mm.
        ior: n, the index of refraction of the slab.
    """
    if gap <= 0.0:
        return distance / math.sqrt(distance * distance + depth * depth)
    limit = (1.0 - 1e-12) / ior
    s = min(distance / math.sqrt(distance * distance + (depth + gap * ior) ** 2), limit)
    for _ in range(40):
        a, b = 1.0 - s * s, 1.0 - ior * ior * s * s
        miss = depth * s / math.sqrt(a) + gap * ior * s / math.sqrt(b) - distance
        step = miss / (depth / (a * math.sqrt(a)) + gap * ior / (b * math.sqrt(b)))
        s = min(max(s - step, 0.0), 0.5 * (s + limit))
        if abs(step) < 1e-14:
            break
    return s


@njit(cache=True)
def facet_normal(eye, point, source, slab):
    """The unit normal at a point of the top that shows a point of the source to an eye (4.3, eq. 2 in vector form).

    ``n ~ i - ior t`` with the unit incoming direction i and the unit direction t inside the slab, by Snell's law. t
    follows from where the ray leaves the flat bottom, see ``sine_in_slab``.

    Args:
        eye: x, y, z of the eye, mm.
        point: x, y, z of the point of the top, mm.
        source: x, y of the point of the source plane, mm.
        slab: the glass, of which ``gap`` and ``ior`` count.

    Returns:
        x, y, z of the normal, which points up.
    """
    x, y, z = point
    ix, iy, iz = x - eye[0], y - eye[1], z - eye[2]
    r = 1.0 / math.sqrt(ix * ix + iy * iy + iz * iz)
    rx, ry = source[0] - x, source[1] - y
    d = math.sqrt(rx * rx + ry * ry)
    s = sine_in_slab(d, z, slab.gap, slab.ior)
    side = s / d if d > 0.0 else 0.0
    nx = ix * r - slab.ior * rx * side
    ny = iy * r - slab.ior * ry * side
    nz = iz * r + slab.ior * math.sqrt(1.0 - s * s)
    q = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * q, ny * q, nz * q
