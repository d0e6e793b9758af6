"""What light meets on its way from the eye to the source, in the tuples that all kernels take.

Lengths are in millimetres. Kernels that run in the lens frame have +y up; those that run on images have y down, and get
an eye that is mirrored in the same way: Snell's law does not change.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from magiclens.contract.artifacts import FloatArray, Lens, Scene


class Slab(NamedTuple):
    """The glass between the reference plane and the source.

    Args:
        depth: from the reference plane down to the flat bottom, mm.
        gap: air between the flat bottom and the source, mm.
        ior: index of refraction of the glass.
    """

    depth: float
    gap: float
    ior: float


class Cut(NamedTuple):
    """The surfaces along which the top is cut into facets.

    Args:
        eye: (3,) float64, mm: the reference eye, which facets are designed for.
        vertical: whether cells are vertical; otherwise they are cut along the rays of ``eye``.
    """

    eye: FloatArray
    vertical: bool


class Optics(NamedTuple):
    """All that refraction at the facets of a lens depends on, but for the facets.

    It has the fields of ``Cut`` and ``Slab``, and can be given to kernels that ask for either. It is flat because numba
    hands no nested tuples to threads.

    Args:
        eye: (3,) float64, mm: the reference eye.
        vertical: whether cells are vertical.
        depth: from the reference plane down to the flat bottom, mm.
        gap: air between the flat bottom and the source, mm.
        ior: index of refraction of the glass.
        cos_limit: cosine of the greatest angle allowed between a facet's normal and +z.
        relief: how far the top may rise or fall from the reference plane, mm.
    """

    eye: FloatArray
    vertical: bool
    depth: float
    gap: float
    ior: float
    cos_limit: float
    relief: float


def slab_of(lens: Lens) -> Slab:
    """The glass of a lens."""
    return Slab(float(lens.thickness_mm), float(lens.gap_mm), float(lens.ior))


def cut_of(scene: Scene) -> Cut:
    """How the lens of a scene is cut into facets, lens frame."""
    eye = scene.reference_eye_mm
    return Cut(eye, scene.lens.cut_along(eye) is None)


def optics_of(lens: Lens, cut: Cut) -> Optics:
    """What the facets of a lens are designed with, if it is cut like this."""
    return Optics(*cut, *slab_of(lens), math.cos(math.radians(lens.max_slope_deg)), float(lens.relief_mm))


def image_optics_of(scene: Scene) -> Optics:
    """What the facets of a scene's lens are designed with, in the frame of images: y down."""
    optics = optics_of(scene.lens, cut_of(scene))
    return optics._replace(eye=optics.eye * (1, -1, 1))
