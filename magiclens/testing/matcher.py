"""The contract of matchers."""

from __future__ import annotations

from typing import Any

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, Scene
from magiclens.contract.checks import check_candidates
from magiclens.contract.stages import Matcher, Progress
from magiclens.geometry.facets import central_slopes
from magiclens.testing.scenes import flat_heights
from magiclens.testing.stage import StageCall, StageContract, digest

_SLACK_MM, _SLACK_DEG = 1e-3, 1.0
"""Excess over the source's border (mm) and over the slope limit (degrees) that is accepted."""


class MatcherContract(StageContract):
    """Checks that candidates are sorted, lie on the source, can be reached by refraction, and resemble the target.

    Attributes:
        error_tolerance_db: By how much the picture of the best candidates may be worse than their errors say.
    """

    stage: Matcher
    error_tolerance_db = 3.0

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Candidates:
        """See StageContract."""
        return self.stage.match(inputs[0], rng, progress)

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_candidates(inputs[0].lens, artifact)

    def test_the_best_candidate_comes_first(self, outcome: StageCall) -> None:
        """Errors ascend in each facet's list."""
        # inf - inf would be NaN, which fails every comparison
        errors = np.where(np.isfinite(outcome.artifact.errors), outcome.artifact.errors, np.finfo(np.float32).max)
        assert (np.diff(errors, axis=-1) >= 0).all(), "errors are not sorted: best first, inf last"

    def test_patches_lie_on_the_source(self, scene: Scene, outcome: StageCall) -> None:
        """Offsets are millimetres from the facet's centre, with +y up."""
        seen = scene.lens.facet_centres_mm()[:, :, None] + outcome.artifact.offsets_mm
        far = np.abs(seen[np.isfinite(outcome.artifact.errors)]).max()
        half = scene.lens.source_size_mm / 2
        assert far <= half + _SLACK_MM, f"a patch is centred {far:.3g} mm from the middle of a source of +-{half:g} mm"

    def test_no_candidate_needs_a_slope_beyond_the_limit(self, scene: Scene, outcome: StageCall) -> None:
        """Candidates that refraction cannot reach are left out."""
        slopes = central_slopes(scene, outcome.artifact.offsets_mm)[np.isfinite(outcome.artifact.errors)]
        steepest = np.degrees(np.arctan(np.linalg.norm(slopes, axis=-1).max()))
        limit = scene.lens.max_slope_deg
        assert steepest <= limit + _SLACK_DEG, f"a candidate needs a slope of {steepest:.1f} deg, above {limit:g}"

    def test_best_candidates_show_the_target_better_than_a_flat_lens(self, scene: Scene, outcome: StageCall) -> None:
        """Offsets and maps mean what ``Candidates`` says; checked of matchers that use pictures."""
        if not self.stage.uses_pictures:
            return
        best, plain = _bound_db(scene, outcome.artifact), _bound_db(scene, _straight_below(scene))
        assert best > plain, f"the best candidates show the target at {best:.1f} dB, no lens at all at {plain:.1f} dB"

    def test_candidates_are_as_good_as_their_errors_say(self, scene: Scene, outcome: StageCall) -> None:
        """Errors are mean squared differences of display values; checked of matchers that use pictures."""
        if not self.stage.uses_pictures:
            return
        claimed = -10 * np.log10(max(float(outcome.artifact.errors.min(axis=-1).mean()), 1e-12))
        found = _bound_db(scene, outcome.artifact)
        assert found >= claimed - self.error_tolerance_db, (
            f"by their errors, the best candidates show the target at {claimed:.1f} dB, but they do at {found:.1f} dB"
        )

    def test_rematching_gives_valid_candidates_and_changes_no_input(self, scene: Scene, outcome: StageCall) -> None:
        """The matcher gets candidates, a lens and traced errors, as in a round of (4.6)."""
        candidates: Candidates = outcome.artifact
        first = Assignment.pick(candidates, candidates.errors.argmin(axis=-1))
        traced = np.full(first.choice.shape, 0.05, np.float32)
        given = (scene, candidates, first, flat_heights(scene), traced)
        before = digest(given)
        check_candidates(scene.lens, self.stage.rematch(*given))
        assert digest(given) == before, "rematch has changed its inputs; work on copies"


def _bound_db(scene: Scene, candidates: Candidates) -> float:
    """PSNR, in dB, of the picture of a lens whose facets show their best candidates exactly."""
    from magiclens.analysis.ideal_picture import bound_psnr_db

    first = Assignment.pick(candidates, candidates.errors.argmin(axis=-1))
    return bound_psnr_db(scene, first, candidates.heights_mm)


def _straight_below(scene: Scene) -> Candidates:
    """Candidates of a lens whose facets show what lies straight below them."""
    n = scene.lens.facets
    maps = np.broadcast_to(np.array([1.0, 0.0, 1.0], np.float32), (n, n, 1, 3))
    return Candidates(np.zeros((n, n, 1, 2), np.float32), maps.copy(), np.zeros((n, n, 1), np.float32))
