"""The contract of finishers."""

from __future__ import annotations

from typing import Any

import numpy as np

from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.checks import check_solid
from magiclens.contract.stages import Finisher, Progress
from magiclens.images import score
from magiclens.testing.meshes import assert_closed, volume_mm3
from magiclens.testing.scenes import bumpy_solid
from magiclens.testing.stage import Made, StageContract


class FinisherContract(StageContract):
    """The solid stays closed and the lens it was.

    ``volume_share``: the most of the volume that may change. ``picture_db``: how much alike the lens's pictures before
    and after must be.
    """

    stage: Finisher
    volume_share = 0.01
    picture_db = 30.0

    def given(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, bumpy_solid(scene)

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Solid:
        """See StageContract."""
        scene, solid = given
        return self.stage.finish(scene, solid, progress)

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_solid(artifact)

    def test_the_solid_is_closed(self, made: Made) -> None:
        """Every edge belongs to two faces that run along it in opposite ways; normals point outward."""
        assert_closed(made.artifact.vertices, made.artifact.faces)

    def test_it_is_as_large_as_before(self, made: Made) -> None:
        """In millimetres, lens frame."""
        before, after = (volume_mm3(solid.vertices, solid.faces) for solid in (made.given[1], made.artifact))
        assert abs(after / before - 1) <= self.volume_share, f"the volume went from {before:.6g} to {after:.6g} mm^3"

    def test_it_shows_the_same(self, scene: Scene, made: Made) -> None:
        """As long as the solid still has the grid that the built-in tracer needs."""
        from magiclens.rendering.tracer import Tracer

        if made.artifact.grid is None:
            return
        tracer = Tracer(resolution=96, samples=2)
        pairs = zip(tracer.render(scene, made.given[1]), tracer.render(scene, made.artifact), strict=True)
        alike = min(score(after, before, 1.0).psnr_db for before, after in pairs)
        assert alike >= self.picture_db, f"what the lens shows has changed: {alike:.1f} dB"
