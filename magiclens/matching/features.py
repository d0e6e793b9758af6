"""What bounds of squared differences know of a tile or a patch: a few of its coordinates, and what these leave out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magiclens.contract.artifacts import FloatArray, IntArray

GREY = np.float32(0.5)
"""Display value from which others are counted, so that sums of squares, and what rounding makes of them, stay small."""
_MOST, _LEAST, _PER_CHANNEL = 24, 8, 2
"""Vectors of a basis: at most, at least, and for each channel beyond two."""
_BEFORE = 3
"""Numbers before the first coordinate."""
FARTHEST = 16000.0
"""Steps from the middle of all values to the farthest: twice that is an int16, and the square of that an int32."""
LOW_BITS = 14
"""Bits of the lower of the two numbers for the sum of squares."""
_LOOKED_AT = 32
"""Patches along each side of a raster from which it is learnt where tiles differ most."""


class Basis(NamedTuple):
    """Orthonormal vectors over the C x P x P values of a tile: mixtures of channels, times cosines along y and along x.

    A mirrored tile has the same coordinates but for signs. Vectors that share their signs follow each other.

    What is known of a tile or patch is a row of int16, taken two by two: the upper and lower LOW_BITS of the sum of the
    squares of the others, the norm of what the vectors leave out, and the coordinates along them, in steps.

    Args:
        mixtures: (C, C) float64, a mixture of channels in each row.
        waves: (P, P) float64, a cosine in each row, of the type II transform.
        vectors: (n, 3): of each vector which mixture it is, which wave along y, and which along x.
        places: (n,) of each vector's coordinate among these numbers.
        ends: (4,) the end, in pairs, of those whose sign no mirroring changes, only that along x does, only that along
            y does, and both do.
        steps: in a unit of display values.
    """

    mixtures: FloatArray
    waves: FloatArray
    vectors: IntArray
    places: IntArray
    ends: IntArray
    steps: float


def _cosines(pixels: int) -> FloatArray:
    """(P, P) float64 orthonormal rows: the cosine transform of type II."""
    k, at = np.arange(pixels)[:, None], np.arange(pixels) + 0.5
    waves: FloatArray = np.sqrt(2 / pixels) * np.cos(np.pi / pixels * k * at)
    waves[0] *= np.sqrt(0.5)
    return waves


def choose_basis(samples: FloatArray, skip_y: int, pixels: int) -> Basis:
    """The vectors along which the patches of a raster differ most.

    Args:
        samples: (C, skip, Y, X / skip) float32 display values, see ``rasters.build_raster``.
        skip_y: samples between two neighbouring pixels of a patch along y.
        pixels: P, along a patch's side.
    """
    channels, _, rows, width = samples.shape
    y = np.linspace(0, max(rows - 1 - (pixels - 1) * skip_y, 0), _LOOKED_AT).astype(int)
    x = np.linspace(0, max(width - pixels, 0), _LOOKED_AT).astype(int)
    down, along = y[:, None] + np.arange(pixels) * skip_y, x[:, None] + np.arange(pixels)
    patches = samples[:, 0][
        :, np.minimum(down, rows - 1)[:, None, :, None], np.minimum(along, width - 1)[None, :, None]
    ]
    patches = patches.reshape(channels, -1, pixels, pixels).astype(np.float64) - GREY
    flat = patches.reshape(channels, -1)
    # not one large product by BLAS: its threads would go on looking for work for a tenth of a second each time
    mixtures = np.linalg.eigh(np.einsum("cn,dn->cd", flat, flat))[1].T[::-1]
    waves = _cosines(pixels)
    energies = ((waves @ np.einsum("mc,cnyx->mnyx", mixtures, patches) @ waves.T) ** 2).sum(axis=1)
    count = min(max(_LEAST, min(_PER_CHANNEL * (channels + 2), _MOST)), energies.size)
    best = np.argsort(-energies.ravel(), kind="stable")[:count]
    vectors = np.stack(np.unravel_index(best, energies.shape), axis=1)
    signs = vectors[:, 1] % 2 * 2 + vectors[:, 2] % 2
    order = np.argsort(signs, kind="stable")
    of_sign = np.bincount(signs, minlength=4)
    of_sign[0] += _BEFORE
    ends = np.cumsum(-(-of_sign // 2))
    begins = 2 * np.concatenate([[0], ends[:-1]])
    places = np.concatenate([begin + np.arange(many) for begin, many in zip(begins, of_sign, strict=True)])[_BEFORE:]
    steps = FARTHEST / (float(GREY) * math.sqrt(channels * pixels * pixels))
    return Basis(np.ascontiguousarray(mixtures), waves, np.ascontiguousarray(vectors[order]), places, ends, steps)
