"""The tuples that say to the kernels of matching what is searched, where, and what has been found.

Coordinates are those of images: millimetres from the lens's centre, x right and y down.
"""

from __future__ import annotations

from typing import NamedTuple

from magiclens.contract.artifacts import FloatArray


class Tiles(NamedTuple):
    """What the facets shall show.

    Args:
        values: (F, C, P, P) float32, or (F, P, P, C) for polishing and evaluation, display values.
        centres: (F, 2) of the facets, mm.
        pitch: side of a facet, mm.
    """

    values: FloatArray
    centres: FloatArray
    pitch: float


class Window(NamedTuple):
    """The square of offsets that are searched around each facet.

    Args:
        half: half its side, mm.
        step: distance between neighbouring offsets, mm; the unit of the distance term (4.2).
        buckets: parts along a side, each of which keeps its best candidate.
    """

    half: float
    step: float
    buckets: int


class Levels(NamedTuple):
    """The source averaged over boxes, for patches that are seen from near and far.

    Args:
        images: (L, H, W, C) float32 display values; for several eyes (L, S, C, H, W) with S sources.
        widths: (L,) side of the boxes, mm.
    """

    images: FloatArray
    widths: FloatArray


class PolishingRule(NamedTuple):
    """How candidates are polished.

    Args:
        most: how many candidates per facet are; the others only get their error.
        iterations: Levenberg-Marquardt steps per candidate, at most.
        isotropic: whether the map stays a multiple of the identity.
    """

    most: int
    iterations: int
    isotropic: bool


class Found(NamedTuple):
    """The candidates of all facets, which kernels fill in place.

    A parallel kernel must not assign to these arrays itself, only in a function that it calls: numba takes what a
    parallel function writes to a tuple's field for unused, and drops it.

    Args:
        errors: (F, K) float32; inf where there is no candidate.
        offsets: (F, K, 2) mm.
        maps: (F, K, 3) as (xx, xy, yy).
    """

    errors: FloatArray
    offsets: FloatArray
    maps: FloatArray
