"""Which patches refraction allows a facet to show, and what their distance costs."""

from __future__ import annotations

from magiclens.kernels.compiler import njit
from magiclens.optics.refraction import facet_normal


@njit(cache=True)
def reachable(centre, offset, m, half, optics):
    """Can a facet show this patch, facing the eye and below the slope limit? Checked at its centre and four corners.

    Args:
        centre: x, y of the facet, mm, image frame (y down).
        offset: x, y of the patch from the facet, mm.
        m: map of the patch (xx, xy, yy).
        half: half the pitch, mm.
        optics: ``Optics`` in the image frame.
    """
    (cx, cy), (rx, ry), (xx, xy, yy) = centre, offset, m
    eye = optics.eye
    for k in range(5):
        px = 0.0 if k == 4 else (half if k & 1 else -half)
        py = 0.0 if k == 4 else (half if k & 2 else -half)
        sx, sy = cx + rx + xx * px + xy * py, cy + ry + xy * px + yy * py
        x, y = cx + px, cy + py
        n = facet_normal(eye, (x, y, optics.depth), (sx, sy), optics)
        faces_eye = n[0] * (eye[0] - x) + n[1] * (eye[1] - y) + n[2] * (eye[2] - optics.depth) > 0.0
        if n[2] < optics.cos_limit or not faces_eye:
            return False
    return True


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
