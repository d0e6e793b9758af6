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
from magiclens.integration.measures import slopes_deg
from magiclens.testing.scenes import an_assignment, ramps
from magiclens.testing.stage import SEED, Made, StageContract, digest

SLACK_MM, SLACK_DEG = 1e-6, 2.0


class IntegratorContract(StageContract):
    """The surface keeps its limits, and facets look where they were told to.

    ``aim_mm``: the most by which the middle of a facet may miss its patch.
    """

    stage: Integrator
    aim_mm = 1.5

    def given(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, an_assignment(scene)

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> HeightField:
        """See StageContract."""
        scene, assignment = given
        return self.stage.integrate(scene, assignment, progress)

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_height_field(given[0].lens, artifact)

    @pytest.fixture(scope="class")
    @classmethod
    def refined(cls, scene: Scene, made: Made) -> Made:
        """What the stage makes of its surface once it is shown the pictures again; itself, if it does not refine."""
        given, progress = (scene, made.artifact), list[float]()
        before = digest(given)
        random.seed(0)
        np.random.seed(0)  # noqa: NPY002
        artifact = cls.stage.refine(*given, progress.append)
        return Made(given, artifact, before, digest(given), progress)

    def test_the_surface_stays_within_its_relief(self, scene: Scene, made: Made) -> None:
        """Heights are millimetres above the reference plane."""
        _assert_within_relief(scene, made.artifact)

    def test_no_micro_facet_is_steeper_than_the_limit(self, scene: Scene, made: Made) -> None:
        """The angle between its normal and +z."""
        _assert_not_steep(scene, made.artifact)

    def test_facets_look_where_they_were_told_to(self, scene: Scene, made: Made) -> None:
        """Traced: signs, axes and units are right."""
        wanted = scene.lens.facet_centres_mm() + made.given[1].offsets_mm
        missed = np.linalg.norm(_seen_mm(scene, made.artifact) - wanted, axis=-1)
        row, column = np.unravel_index(missed.argmax(), missed.shape)
        assert missed.max() <= self.aim_mm, (
            f"facet row {row}, column {column} looks {missed.max():.2f} mm off its patch, {self.aim_mm:g} will do"
        )

    def test_refining_keeps_the_limits(self, scene: Scene, refined: Made) -> None:
        """A valid height field, within relief and slope limit."""
        try:
            self.check(refined.given, refined.artifact)
        except BadArtifact as error:
            pytest.fail(f"the refined surface breaks the contract: {error}")
        _assert_within_relief(scene, refined.artifact)
        _assert_not_steep(scene, refined.artifact)

    def test_refining_changes_no_input(self, refined: Made) -> None:
        """Scene and surface are read-only."""
        assert refined.after == refined.before, "refine has changed what it was given; work on copies"

    def test_refining_twice_gives_the_same(self, refined: Made) -> None:
        """Nothing is drawn by lot: there is no rng to draw from."""
        random.seed(SEED)
        np.random.seed(SEED)  # noqa: NPY002
        again = self.stage.refine(*refined.given)
        assert digest(again) == digest(refined.artifact), "the same inputs were refined to two different surfaces"

    def test_refining_tells_its_progress_in_fractions_that_grow(self, refined: Made) -> None:
        """From 0 to 1; none at all is fine."""
        told = np.array([0.0, *refined.progress, 1.0])
        assert (np.diff(told) >= 0).all(), f"progress was told {list(refined.progress)}; fractions of 1, never less"


def _assert_within_relief(scene: Scene, built: HeightField) -> None:
    tallest, limit = np.abs(built.heights_mm).max(), scene.lens.relief_mm
    assert tallest <= limit + SLACK_MM, f"it leaves the reference plane by {tallest:.3g} mm, the limit is {limit:g}"


def _assert_not_steep(scene: Scene, built: HeightField) -> None:
    steepest, limit = _steepest_deg(built), scene.lens.max_slope_deg
    assert steepest <= limit + SLACK_DEG, f"a micro-facet slopes by {steepest:.1f} deg, the limit is {limit:g}"


def _steepest_deg(built: HeightField) -> float:
    return float(slopes_deg(built.facet_points_mm()).max())


def _seen_mm(scene: Scene, built: HeightField) -> FloatArray:
    """(N, N, 2) the places of the source, lens frame, that the first view's eye sees in the middles of the facets."""
    from magiclens.rendering.tracer import Tracer

    n, size = scene.lens.facets, scene.lens.source_size_mm
    (picture, *_) = Tracer(resolution=16 * n, samples=2).render(ramps(scene), solid_from_heights(built))
    blocks = picture.reshape(n, 16, n, 16, 3)[:, 6:10, :, 6:10].astype(np.float64).mean(axis=(1, 3))
    seen: FloatArray = (blocks[..., :2] / np.maximum(blocks[..., 2:], 1e-6) - 0.5) * size
    return seen
