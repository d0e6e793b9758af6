"""The contract of integrators."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

from magiclens.contract.artifacts import FloatArray, HeightField, Scene
from magiclens.contract.checks import BadArtifact, check_height_field
from magiclens.contract.stages import Integrator, Progress
from magiclens.geometry.solid import solid_from_heights
from magiclens.integration.surface_metrics import facet_slopes_deg
from magiclens.testing.scenes import an_assignment, ramps
from magiclens.testing.stage import SEED, StageCall, StageContract, assert_progress, digest

_SLACK_MM, _SLACK_DEG = 1e-6, 2.0
"""Excess over the limits of height (mm) and of slope (degrees) that is accepted."""


class IntegratorContract(StageContract):
    """Checks that the surface keeps its limits, and that facets show their patches.

    Attributes:
        offset_tolerance_mm: Largest distance between the centre of a facet's patch and the point of the source that is
            seen through the middle of the facet.
    """

    stage: Integrator
    offset_tolerance_mm = 1.5

    def inputs(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, an_assignment(scene)

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> HeightField:
        """See StageContract."""
        scene, assignment = inputs
        return self.stage.integrate(scene, assignment, progress)

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_height_field(inputs[0].lens, artifact)

    @pytest.fixture(scope="class")
    @classmethod
    def refined(cls, scene: Scene, outcome: StageCall) -> StageCall:
        """What the stage makes of its own surface when it refines it."""
        inputs, progress = (scene, outcome.artifact), list[float]()
        before = digest(inputs)
        # the second call below starts from other states of the global generators
        random.seed(0)
        np.random.seed(0)  # noqa: NPY002
        artifact = cls.stage.refine(*inputs, progress.append)
        return StageCall(inputs, artifact, before, digest(inputs), progress)

    def test_the_surface_stays_within_its_relief(self, scene: Scene, outcome: StageCall) -> None:
        """No vertex is farther from the reference plane than the lens allows."""
        _assert_within_relief(scene, outcome.artifact)

    def test_no_micro_facet_is_steeper_than_the_limit(self, scene: Scene, outcome: StageCall) -> None:
        """The slope is the angle between its normal and +z."""
        _assert_not_steep(scene, outcome.artifact)

    def test_facets_show_their_patches(self, scene: Scene, outcome: StageCall) -> None:
        """The lens is traced, so signs, axes and units are right."""
        centres = scene.lens.facet_centres_mm() + outcome.inputs[1].offsets_mm
        missed = np.linalg.norm(_seen_mm(scene, outcome.artifact) - centres, axis=-1)
        row, column = np.unravel_index(missed.argmax(), missed.shape)
        assert missed.max() <= self.offset_tolerance_mm, (
            f"facet row {row}, column {column} shows a point {missed.max():.2f} mm from the centre of its patch; "
            f"{self.offset_tolerance_mm:g} mm is allowed"
        )

    def test_refining_keeps_the_limits(self, scene: Scene, refined: StageCall) -> None:
        """The refined height field is valid and keeps the limits of height and slope."""
        try:
            self.check(refined.inputs, refined.artifact)
        except BadArtifact as error:
            pytest.fail(f"the refined surface breaks the contract: {error}")
        _assert_within_relief(scene, refined.artifact)
        _assert_not_steep(scene, refined.artifact)

    def test_refining_changes_no_input(self, refined: StageCall) -> None:
        """Scene and height field are read-only."""
        assert refined.after == refined.before, "refine has changed its inputs; work on copies"

    def test_refining_twice_gives_the_same(self, refined: StageCall) -> None:
        """Refining uses no random numbers."""
        random.seed(SEED)
        np.random.seed(SEED)  # noqa: NPY002
        again = self.stage.refine(*refined.inputs)
        assert digest(again) == digest(refined.artifact), "the same inputs were refined to two different surfaces"

    def test_refining_tells_its_progress_in_fractions_that_grow(self, refined: StageCall) -> None:
        """They go from 0 to 1; a stage need not report any."""
        assert_progress(refined)


def _assert_within_relief(scene: Scene, built: HeightField) -> None:
    tallest, limit = np.abs(built.heights_mm).max(), scene.lens.relief_mm
    assert tallest <= limit + _SLACK_MM, f"it leaves the reference plane by {tallest:.3g} mm, the limit is {limit:g}"


def _assert_not_steep(scene: Scene, built: HeightField) -> None:
    steepest, limit = _steepest_deg(built), scene.lens.max_slope_deg
    assert steepest <= limit + _SLACK_DEG, f"a micro-facet slopes by {steepest:.1f} deg, the limit is {limit:g}"


def _steepest_deg(built: HeightField) -> float:
    return float(facet_slopes_deg(built.facet_points_mm()).max())


def _seen_mm(scene: Scene, built: HeightField) -> FloatArray:
    """Points of the source that the eye of the first view sees through the middles of the facets.

    The colour of every point of the source tells where it is, see ``ramps``. The first view of all scenes is not
    turned, so it is in the lens frame.

    Returns:
        (N, N, 2) float64, mm, lens frame.
    """
    from magiclens.rendering.tracer import Tracer

    n, size = scene.lens.facets, scene.lens.source_size_mm
    (picture, *_) = Tracer(resolution=16 * n, samples=2).render(ramps(scene), solid_from_heights(built))
    # the middle of each facet's 16 x 16 pixels, away from walls
    blocks = picture.reshape(n, 16, n, 16, 3)[:, 6:10, :, 6:10].astype(np.float64).mean(axis=(1, 3))
    # blue is 1 everywhere in the source, so it is the light that passes the lens
    seen: FloatArray = (blocks[..., :2] / np.maximum(blocks[..., 2:], 1e-6) - 0.5) * size
    return seen
