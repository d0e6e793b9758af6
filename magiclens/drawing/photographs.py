"""Simulated photographs, at the exposure at which they are compared with the targets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from magiclens.contract.artifacts import FloatArray, View
from magiclens.contract.result import RunResult
from magiclens.images.resample import resize
from magiclens.images.score import Score, score


@dataclass(frozen=True)
class Photograph:
    """A rendered picture (R, R, C) and its target (R, R, C), float32, linear light; the picture is exposed, 0 to 1."""

    picture: FloatArray
    target: FloatArray
    score: Score

    @property
    def caption(self) -> str:
        """PSNR and SSIM as figures write them."""
        return f"{self.score.psnr_db:.1f} dB, SSIM {self.score.ssim:.2f}"


def photograph(picture: FloatArray, view: View, gain: float | None = None) -> Photograph:
    """Expose a rendered picture of a view as its score does.

    Args:
        picture: (R, R, C) linear light, in any unit.
        view: The view that the picture shows; its target is resized to the picture.
        gain: 1 for a picture that is exposed already; by default the gain that fits the target best.

    Returns:
        The picture after one gain, clipped to 0..1, with its target and its score.
    """
    target = resize(view.target, picture.shape[:2])
    found = score(picture, target, gain)
    return Photograph(np.clip(picture * np.float32(found.gain), 0, 1), target, found)


@lru_cache(maxsize=1)
def photographs(result: RunResult) -> dict[str, list[Photograph]]:
    """The photographs of a run by renderer, one for each view; kept, since several figures and the page show them."""
    return {
        renderer: [photograph(picture, view) for picture, view in zip(pictures, result.scene.views, strict=True)]
        for renderer, pictures in result.renders.items()
    }
