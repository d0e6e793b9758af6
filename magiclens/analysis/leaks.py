"""Which facets see which pixels of a source, as traced: is a lens injective (5.1, figure 7), and what strays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Transport

TRACE = 0.01
"""A facet sees a pixel if it draws more than this share of the strongest weight on it.

Less cannot be noticed: paint the pixel black instead of white, and the picture loses a hundredth of one pixel's light.
"""


def leaks(transports: Sequence[Transport], facets: int, reserved: BoolArray | None = None) -> dict[str, float]:
    """For the manifest: the most facets that see a pixel in one view, and the light that strays, mean over the views.

    ``leak`` is the share of a white source's picture that comes from pixels which are rather another facet's,
    ``leak_from_reserved`` that from reserved pixels.
    """
    different = {id(transport): transport for transport in transports}.values()
    seen = [sightings(transport, facets) for transport in different]
    found = {
        "overlap_max": float(max(sighted(s).max() for s in seen)),
        "leak": float(np.mean([strayed(s) for s in seen])),
    }
    if reserved is not None:
        kept = reserved.ravel()
        found["leak_from_reserved"] = float(np.mean([_drawn(s)[kept].sum() / max(s.sum(), 1e-30) for s in seen]))
    return found


def sightings(transport: Transport, facets: int) -> csr_array:
    """(facets^2, source pixels): how much each facet's part of the picture draws from each source pixel.

    Facets are numbered row by row in the picture; a picture's pixel belongs to the facet in which its centre lies.
    """
    rows, columns = (((np.arange(side) + 0.5) * facets / side).astype(int) for side in transport.shape)
    facet = (rows[:, None] * facets + columns).ravel()
    gather = csr_array((np.ones(facet.size, np.float32), (facet, np.arange(facet.size))), (facets**2, facet.size))
    return csr_array(gather @ transport.matrix)


def sighted(seen: csr_array) -> IntArray:
    """(source pixels,) how many facets see each."""
    strong = seen.data > TRACE * seen.data.max(initial=0.0)
    return np.bincount(seen.indices[strong], minlength=seen.shape[1])


def strayed(seen: csr_array) -> float:
    """The share of all weight that is not that of the facet which draws most from a pixel."""
    own: FloatArray = np.zeros(seen.shape[1])
    np.maximum.at(own, seen.indices, seen.data)
    return max(0.0, float(1 - own.sum() / max(float(seen.sum(dtype=np.float64)), 1e-30)))


def _drawn(seen: csr_array) -> FloatArray:
    return np.asarray(seen.sum(axis=0), np.float64).ravel()
