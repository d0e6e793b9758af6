"""The contract of matchers."""

from __future__ import annotations

from typing import Any

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, Scene
from magiclens.contract.checks import check_candidates
from magiclens.contract.stages import Matcher, Progress
from magiclens.geometry.facets import central_slopes
from magiclens.testing.scenes import flat_heights
from magiclens.testing.stage import Made, StageContract, digest

SLACK_MM, SLACK_DEG = 1e-3, 1.0


class MatcherContract(StageContract):
    """Candidates lie on the source, can be refracted to, come best first, and look like the target.

    ``claim_db``: by how much candidates may look worse than their errors say.
    """

    stage: Matcher
    claim_db = 3.0

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Candidates:
        """See StageContract."""
        return self.stage.match(given[0], rng, progress)

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_candidates(given[0].lens, artifact)

    def test_the_best_candidate_comes_first(self, made: Made) -> None:
        """Errors grow along each facet's list."""
        errors = np.where(np.isfinite(made.artifact.errors), made.artifact.errors, np.finfo(np.float32).max)
        assert (np.diff(errors, axis=-1) >= 0).all(), "errors are not sorted: best first, inf last"

    def test_patches_lie_on_the_source(self, scene: Scene, made: Made) -> None:
        """Offsets are millimetres from the facet's centre, +y up."""
        seen = scene.lens.facet_centres_mm()[:, :, None] + made.artifact.offsets_mm
        far = np.abs(seen[np.isfinite(made.artifact.errors)]).max()
        half = scene.lens.source_size_mm / 2
        assert far <= half + SLACK_MM, f"a patch is centred {far:.3g} mm from the middle of a source of +-{half:g} mm"

    def test_no_facet_is_asked_for_a_slope_beyond_the_limit(self, scene: Scene, made: Made) -> None:
        """What refraction cannot reach is left out."""
        slopes = central_slopes(scene, made.artifact.offsets_mm)[np.isfinite(made.artifact.errors)]
        steepest = np.degrees(np.arctan(np.linalg.norm(slopes, axis=-1).max()))
        limit = scene.lens.max_slope_deg
        assert steepest <= limit + SLACK_DEG, f"a candidate needs a slope of {steepest:.1f} deg, the limit is {limit:g}"

    def test_the_best_look_more_like_the_target_than_a_plain_slab(self, scene: Scene, made: Made) -> None:
        """Offsets, maps and errors mean what ``Candidates`` says; asked of matchers that look at the pictures."""
        if not self.stage.uses_pictures:
            return
        best, plain = _bound_db(scene, made.artifact), _bound_db(scene, _unmoved(scene))
        assert best > plain, f"the best candidates show the target at {best:.1f} dB, no lens at all at {plain:.1f} dB"

    def test_candidates_look_as_their_errors_say(self, scene: Scene, made: Made) -> None:
        """Errors are mean squared differences of display values; asked of matchers that look at the pictures."""
        if not self.stage.uses_pictures:
            return
        claimed = -10 * np.log10(max(float(made.artifact.errors.min(axis=-1).mean()), 1e-12))
        found = _bound_db(scene, made.artifact)
        assert found >= claimed - self.claim_db, (
            f"by their errors, the best candidates show the target at {claimed:.1f} dB, but they do at {found:.1f} dB"
        )

    def test_rematching_gives_valid_candidates_and_changes_no_input(self, scene: Scene, made: Made) -> None:
        """After the lens is built and traced (4.6)."""
        candidates: Candidates = made.artifact
        first = Assignment.pick(candidates, candidates.errors.argmin(axis=-1))
        traced = np.full(first.choice.shape, 0.05, np.float32)
        given = (scene, candidates, first, flat_heights(scene), traced)
        before = digest(given)
        check_candidates(scene.lens, self.stage.rematch(*given))
        assert digest(given) == before, "rematch has changed what it was given; work on copies"


def _bound_db(scene: Scene, candidates: Candidates) -> float:
    """PSNR if every facet realised its best candidate exactly."""
    from magiclens.analysis.ideal_picture import bound_psnr_db

    first = Assignment.pick(candidates, candidates.errors.argmin(axis=-1))
    return bound_psnr_db(scene, first, candidates.heights_mm)


def _unmoved(scene: Scene) -> Candidates:
    """Every facet shows what lies below it."""
    n = scene.lens.facets
    maps = np.broadcast_to(np.array([1.0, 0.0, 1.0], np.float32), (n, n, 1, 3))
    return Candidates(np.zeros((n, n, 1, 2), np.float32), maps.copy(), np.zeros((n, n, 1), np.float32))
