"""The contract of renderers."""

from __future__ import annotations

from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, Scene
from magiclens.contract.checks import check_pictures
from magiclens.contract.stages import Progress, Renderer
from magiclens.images import resize, score
from magiclens.testing.scenes import bumpy_solid
from magiclens.testing.stage import Made, StageContract


class RendererContract(StageContract):
    """Pictures are light, and show what the built-in tracer shows.

    ``agreement_db``: how much alike each picture and the tracer's must be, after one exposure.
    """

    stage: Renderer
    agreement_db = 25.0

    def given(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, bumpy_solid(scene)

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> list[FloatArray]:
        """See StageContract."""
        scene, solid = given
        return self.stage.render(scene, solid, progress)

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_pictures(given[0], artifact)

    def test_light_is_never_negative(self, made: Made) -> None:
        """Linear light."""
        assert min(picture.min() for picture in made.artifact) >= 0, "a picture has negative light"

    def test_it_agrees_with_the_built_in_tracer(self, scene: Scene, made: Made) -> None:
        """In the world frame: row 0 is +y, and the picture turns with the lens."""
        from magiclens.rendering.tracer import Tracer

        side = len(made.artifact[0])
        traced = Tracer(resolution=max(side, 16), samples=3).render(*made.given)
        for view, mine, other in zip(scene.views, made.artifact, traced, strict=True):
            alike = score(mine, resize(np.clip(other, 0, 1), (side, side))).psnr_db
            assert alike >= self.agreement_db, f"{view.name}: {alike:.1f} dB from what the built-in tracer shows"
