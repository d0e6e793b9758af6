"""Scores that compare a picture seen through the lens with its target."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.colour import to_display
from magiclens.images.resample import resize


@dataclass(frozen=True)
class Score:
    """PSNR and SSIM of display values, after light was multiplied by the exposure ``gain``."""

    psnr_db: float
    ssim: float
    gain: float


ScoresByRenderer = Mapping[str, Sequence[Score]]
"""Lists of one score per view, by renderer type."""


def score(render_linear: FloatArray, target_linear: FloatArray, gain: float | None = None) -> Score:
    """Compare a render with its target in display values.

    Args:
        render_linear: (R, R, C) linear light.
        target_linear: (H, W, C) linear light, resized to the render. The two may have 1 and 3 channels.
        gain: Exposure by which the render is multiplied; by default the one that fits the target best (least squares).
    """
    from magiclens.images.score_kernels import structural_similarity

    seen, wanted, gain = _exposed(render_linear, target_linear, gain)
    return Score(psnr_db(seen, wanted), structural_similarity(seen.mean(-1), wanted.mean(-1)), gain)


def best_exposure_psnr_db(render_linear: FloatArray, target_linear: FloatArray) -> float:
    """The PSNR alone of ``score``, without SSIM, which takes most of its time."""
    seen, wanted, _ = _exposed(render_linear, target_linear, None)
    return psnr_db(seen, wanted)


def _exposed(
    render_linear: FloatArray, target_linear: FloatArray, gain: float | None
) -> tuple[FloatArray, FloatArray, float]:
    """Display values of an exposed render and of its target, and the exposure."""
    target = resize(target_linear, render_linear.shape[:2]).astype(np.float64)
    render, target = np.broadcast_arrays(render_linear.astype(np.float64), target)
    if gain is None:
        gain = float((render * target).sum() / max(float((render**2).sum()), 1e-12))
    return to_display(render * gain), to_display(target), gain


def psnr_db(seen: FloatArray, wanted: FloatArray) -> float:
    """Peak signal-to-noise ratio, dB, of two arrays of display values 0..1 of the same shape; at most 120."""
    return float(-10 * np.log10(max(float(np.mean((seen - wanted) ** 2)), 1e-12)))
