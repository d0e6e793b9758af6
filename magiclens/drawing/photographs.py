"""What the renderers saw, at the exposure at which it is compared with the targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magiclens.contract.artifacts import FloatArray, View
from magiclens.contract.result import RunResult
from magiclens.images.resample import resize
from magiclens.images.score import Score, score


@dataclass(frozen=True)
class Photograph:
    """picture: (R, R, C) float32, linear light 0..1, exposed; target: (R, R, C) float32, what it should be."""

    picture: FloatArray
    target: FloatArray
    score: Score

    @property
    def caption(self) -> str:
        """The scores, as figures write them."""
        return f"{self.score.psnr_db:.1f} dB, SSIM {self.score.ssim:.2f}"


def photograph(picture: FloatArray, view: View) -> Photograph:
    """A picture (R, R, C) in linear light, exposed and scored as the view's."""
    target = resize(view.target, picture.shape[:2])
    found = score(picture, target)
    return Photograph(np.clip(picture * np.float32(found.gain), 0, 1), target, found)


def photographs(data: RunResult) -> dict[str, list[Photograph]]:
    """By renderer, one per view."""
    return {
        renderer: [photograph(picture, view) for picture, view in zip(pictures, data.scene.views, strict=True)]
        for renderer, pictures in data.renders.items()
    }
