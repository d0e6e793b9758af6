"""Which patches refraction allows a facet to show, and what their distance costs."""

from __future__ import annotations

import math

from magiclens.kernels.compiler import njit
from magiclens.optics.lenslets import tallest
from magiclens.optics.refraction import facet_normal

_LOW = 3.0
"""A lenslet rises by less than its steepest slope times this times half its side, twice what a plane does."""
_ROUNDING = 1e-9
"""The share by which estimates stay on the safe side."""
_SPARE = 1.15
"""Relief that a lenslet must leave to spare: it is up to an eighth taller than nine points of it tell."""


@njit(cache=True)
def least_upright(centre, offset, m, half, optics):
    """The least z of a facet's normals where it shows a patch, -1 if it faces away from the eye or is too steep.

    The slopes are checked at its centre and four corners.

    Args:
        centre: x, y of the facet, mm, image frame (y down).
        offset: x, y of the patch from the facet, mm.
        m: map of the patch (xx, xy, yy).
        half: half the pitch, mm.
        optics: ``Optics`` in the image frame.
    """
    (cx, cy), (rx, ry), (xx, xy, yy) = centre, offset, m
    eye, upright = optics.eye, 1.0
    for k in range(5):
        px = 0.0 if k == 4 else (half if k & 1 else -half)
        py = 0.0 if k == 4 else (half if k & 2 else -half)
        sx, sy = cx + rx + xx * px + xy * py, cy + ry + xy * px + yy * py
        x, y = cx + px, cy + py
        n = facet_normal(eye, (x, y, optics.depth), (sx, sy), optics)
        faces_eye = n[0] * (eye[0] - x) + n[1] * (eye[1] - y) + n[2] * (eye[2] - optics.depth) > 0.0
        if n[2] < optics.cos_limit or not faces_eye:
            return -1.0
        upright = min(upright, n[2])
    return upright


@njit(cache=True)
def _surely_reachable(centre, offset, m, half, optics):
    """Whether ``reachable`` is true by the triangle inequality alone: the steepest that any ray asks for is allowed."""
    (cx, cy), (rx, ry), (xx, xy, yy), eye = centre, offset, m, optics.eye
    corner = math.sqrt(2.0) * half
    aside = math.sqrt((cx - eye[0]) ** 2 + (cy - eye[1]) ** 2) + corner
    stretch = abs(xy) + max(abs(xx - 1.0), abs(yy - 1.0))
    far, above = math.sqrt(rx * rx + ry * ry) + stretch * corner, eye[2] - optics.depth
    sin_in, sin_slab = aside / math.sqrt(aside**2 + above**2), far / math.sqrt(far**2 + optics.depth**2)
    cos_in, cos_slab = math.sqrt(1.0 - sin_in * sin_in), math.sqrt(1.0 - sin_slab * sin_slab)
    if not (above > 0.0 and optics.ior * (cos_in * cos_slab - sin_in * sin_slab) > 1.0 + _ROUNDING):
        return False
    slope = (sin_in + optics.ior * sin_slab) / (optics.ior * cos_slab - 1.0) * (1.0 + _ROUNDING)
    upright = (1.0 - _ROUNDING) / math.sqrt(1.0 + slope * slope)
    return upright >= optics.cos_limit and _LOW * slope * half <= optics.relief


@njit(cache=True)
def reachable(centre, offset, m, half, optics):
    """Can a facet show this patch, below the slope limit and within the relief? Arguments: see ``least_upright``."""
    if _surely_reachable(centre, offset, m, half, optics):
        return True
    upright = least_upright(centre, offset, m, half, optics)
    if upright < 0.0:
        return False
    slope = math.sqrt(max(1.0 - upright * upright, 0.0)) / upright
    return _LOW * slope * half <= optics.relief or _SPARE * tallest(centre, offset, m, half, optics) <= optics.relief


@njit(cache=True)
def distance_term(rx, ry, window):
    """The distance term of 4.2, lambda M_s per pixel of a tile: ``1 / (m^2 - R^2) - 1 / m^2``, R in search steps.

    Args:
        rx, ry: the offset, mm.
        window: the search window; m is its side in steps.

    Returns:
        The term in squared display values from 0 to 1.
    """
    m2 = (2.0 * window.half / window.step) ** 2
    return 1.0 / (m2 - (rx * rx + ry * ry) / (window.step * window.step)) - 1.0 / m2
