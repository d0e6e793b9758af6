"""Inpainting: the unknown pixels of a picture are filled smoothly from known ones around them (section 5.2)."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray
from magiclens.images.colour import to_display, to_linear
from magiclens.images.resample import halved

_OVER_RELAXATION = 1.8
"""Factor of successive over-relaxation; 1 is plain relaxation, 2 diverges."""


def inpaint(linear: FloatArray, known: BoolArray) -> FloatArray:
    """Fill the unknown pixels of a picture harmonically: each is the mean of its four neighbours, in display values.

    The fill is found from coarse to fine, with a few sweeps of successive over-relaxation at each size.

    Args:
        linear: (H, W, C) linear light; what unknown pixels hold is ignored.
        known: (H, W) pixels that come back unchanged.

    Returns:
        (H, W, C) linear light, dtype of the argument.

    Raises:
        ValueError: No pixel is known.
    """
    if not known.any():
        raise ValueError("no pixel of the picture is known")
    values = to_display(np.where(known[..., None], linear, 0)).astype(np.float32)
    filled = _filled(values, known.astype(np.float32))
    out = linear.copy()
    out[~known] = to_linear(filled[~known])
    return out


def _filled(values: FloatArray, share: FloatArray) -> FloatArray:
    """(H, W, C) filled; ``share`` (H, W) is how much of a pixel is known, ``values`` (H, W, C) is multiplied by it."""
    from magiclens.images.inpaint_kernels import enlarge_unknown, relax_unknown

    known = share > 0
    picture = values / np.where(known, share, 1)[..., None]
    if not known.all():
        enlarge_unknown(_filled(halved(values), halved(share)), known, picture)
        relax_unknown(picture, known, np.float32(_OVER_RELAXATION))
    return picture
