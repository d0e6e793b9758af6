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
from magiclens.testing.stage import StageCall, StageContract


class FinisherContract(StageContract):
    """Checks that the solid stays closed, keeps its volume, and shows the same.

    Attributes:
        volume_tolerance: Largest change of the volume, as a share.
        least_agreement_db: Least PSNR between pictures of the lens after and before.
    """

    stage: Finisher
    volume_tolerance = 0.01
    least_agreement_db = 30.0

    def inputs(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, bumpy_solid(scene)

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Solid:
        """See StageContract."""
        scene, solid = inputs
        return self.stage.finish(scene, solid, progress)

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_solid(artifact)

    def test_the_solid_is_closed(self, outcome: StageCall) -> None:
        """Every edge belongs to two faces that run along it in opposite ways; normals point outward."""
        assert_closed(outcome.artifact.vertices, outcome.artifact.faces)

    def test_it_is_as_large_as_before(self, outcome: StageCall) -> None:
        """Its volume is about the same."""
        before, after = (volume_mm3(solid.vertices, solid.faces) for solid in (outcome.inputs[1], outcome.artifact))
        change = abs(after / before - 1)
        assert change <= self.volume_tolerance, f"the volume went from {before:.6g} to {after:.6g} mm^3"

    def test_it_shows_the_same(self, scene: Scene, outcome: StageCall) -> None:
        """Pictures before and after agree; checked if the solid still has the grid that the built-in tracer needs."""
        from magiclens.rendering.tracer import Tracer

        if outcome.artifact.grid is None:
            return
        tracer = Tracer(resolution=96, samples=2)
        pairs = zip(tracer.render(scene, outcome.inputs[1]), tracer.render(scene, outcome.artifact), strict=True)
        # exposure 1, not the one that fits best: a finisher must not darken the picture either
        agreement = min(score(after, before, 1.0).psnr_db for before, after in pairs)
        assert agreement >= self.least_agreement_db, f"pictures before and after differ: {agreement:.1f} dB"
