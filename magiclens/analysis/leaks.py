"""Which facets see which pixels of a source, as traced: whether a lens is injective (5.1, figure 7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import BoolArray, FloatArray, IntArray, Transport
from magiclens.contract.result import RunResult
from magiclens.images.resample import pixels_touching
from magiclens.plan.compile import Plan

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_VISIBLE = 0.01
"""A facet sees a pixel if it draws more than this share of the strongest weight on it.

Less than that is not visible: if the pixel is painted black instead of white, the picture loses a hundredth of the
light of one pixel.
"""


def leaks(transports: Sequence[Transport], facets: int, reserved: BoolArray | None = None) -> dict[str, float]:
    """How far a lens is from injective: no pixel seen through two facets, no light from another facet's pixels.

    Args:
        transports: One matrix per view.
        facets: Facets N along one side.
        reserved: (H, W) bool, pixels of the source that no facet may see; None if there are none.

    Returns:
        ``overlap_max``, the largest number of facets that see one pixel in one view; ``leak``, the share of a white
        source's picture that comes from pixels of which another facet draws more; with reserved pixels also
        ``leak_from_reserved``, the share that comes from these. Shares are means over the views.
    """
    different = list({id(transport): transport for transport in transports}.values())
    seen = [facet_weights(transport, facets) for transport in different]
    found = {
        "overlap_max": float(max(facets_per_pixel(s).max() for s in seen)),
        "leak": float(np.mean([leaked_share(s) for s in seen])),
    }
    if reserved is not None:
        kept = [pixels_touching(reserved, transport.source_shape).ravel() for transport in different]
        shares = [_drawn(s)[k].sum() / max(s.sum(), 1e-30) for s, k in zip(seen, kept, strict=True)]
        found["leak_from_reserved"] = float(np.mean(shares))
    return found


def facet_weights(transport: Transport, facets: int) -> csr_array:
    """(facets^2, source pixels): how much each facet's part of the picture draws from each source pixel.

    Facets are numbered row by row in the picture; a picture's pixel belongs to the facet in which its centre lies.
    """
    from scipy.sparse import csr_array

    rows, columns = (((np.arange(side) + 0.5) * facets / side).astype(int) for side in transport.shape)
    facet = (rows[:, None] * facets + columns).ravel()
    gather = csr_array((np.ones(facet.size, np.float32), (facet, np.arange(facet.size))), (facets**2, facet.size))
    return csr_array(gather @ transport.matrix)


def facets_per_pixel(seen: csr_array) -> IntArray:
    """(source pixels,) number of facets that see each pixel."""
    strong = seen.data > _VISIBLE * seen.data.max(initial=0.0)
    return np.bincount(seen.indices[strong], minlength=seen.shape[1])


def leaked_share(seen: csr_array) -> float:
    """The share of all weight that is not that of the facet which draws most from a pixel."""
    own: FloatArray = np.zeros(seen.shape[1])
    np.maximum.at(own, seen.indices, seen.data)
    return max(0.0, float(1 - own.sum() / max(float(seen.sum(dtype=np.float64)), 1e-30)))


def _drawn(seen: csr_array) -> FloatArray:
    return np.asarray(seen.sum(axis=0), np.float64).ravel()


def _applies(plan: Plan) -> bool:
    return plan.encoder is not None


def _compute(plan: Plan, result: RunResult) -> Findings:
    return Findings(leaks(result.transports, plan.lens.facets, result.given.reserved))


LEAKS = Analysis("leaks", _applies, _compute)
"""Whether facets share pixels of a source that an encoder paints."""
