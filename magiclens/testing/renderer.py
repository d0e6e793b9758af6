"""The contract of renderers."""

from __future__ import annotations

from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, Scene
from magiclens.contract.checks import check_pictures
from magiclens.contract.stages import Progress, Renderer
from magiclens.images import resize, score
from magiclens.testing.scenes import bumpy_solid
from magiclens.testing.stage import StageCall, StageContract


class RendererContract(StageContract):
    """Checks that pictures are light, and agree with those of the built-in tracer.

    Attributes:
        least_agreement_db: Least PSNR between each picture and the tracer's, after one exposure.
    """

    stage: Renderer
    least_agreement_db = 25.0

    def inputs(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, bumpy_solid(scene)

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> list[FloatArray]:
        """See StageContract."""
        scene, solid = inputs
        return self.stage.render(scene, solid, progress)

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_pictures(inputs[0], artifact)

    def test_light_is_never_negative(self, outcome: StageCall) -> None:
        """Pixels are linear light."""
        assert min(picture.min() for picture in outcome.artifact) >= 0, "a picture has negative light"

    def test_it_agrees_with_the_built_in_tracer(self, scene: Scene, outcome: StageCall) -> None:
        """Pictures are in the world frame: row 0 is at +y, and what is seen turns with the lens."""
        from magiclens.rendering.tracer import Tracer

        side = len(outcome.artifact[0])
        # the tracer's resolution is at least 16; a coarser picture is compared with the tracer's, resized
        traced = Tracer(resolution=max(side, 16), samples=3).render(*outcome.inputs)
        for view, mine, other in zip(scene.views, outcome.artifact, traced, strict=True):
            agreement = score(mine, resize(np.clip(other, 0, 1), (side, side))).psnr_db
            assert agreement >= self.least_agreement_db, f"{view.name}: {agreement:.1f} dB from the built-in tracer's"
