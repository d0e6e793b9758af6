"""The contract of annealers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, Scene
from magiclens.contract.checks import check_assignment
from magiclens.contract.stages import Annealer, Progress
from magiclens.testing.scenes import some_candidates
from magiclens.testing.stage import SEED, Made, StageContract, digest

SLACK = 1e-9


class AnnealerContract(StageContract):
    """One of each facet's own candidates is chosen, and the energy does not rise."""

    stage: Annealer

    def given(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, some_candidates(scene)

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Assignment:
        """See StageContract."""
        scene, candidates = given
        return self.stage.anneal(scene, candidates, rng, progress)

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_assignment(given[0].lens, given[1], artifact)

    def test_the_energy_is_never_worse(self, made: Made) -> None:
        """``metrics`` tells it before and after."""
        metrics = made.artifact.metrics
        assert {"energy_before", "energy_after"} <= set(metrics), "metrics needs energy_before and energy_after"
        before, after = metrics["energy_before"], metrics["energy_after"]
        assert after <= before + SLACK * abs(before), f"the energy rose from {before:g} to {after:g}"

    def test_what_is_assigned_is_what_was_chosen(self, made: Made) -> None:
        """Offsets, maps and errors are those of the candidates; ``Assignment.pick`` does that."""
        picked = Assignment.pick(made.given[1], made.artifact.choice, dict(made.artifact.metrics))
        assert digest(picked) == digest(made.artifact), "the assignment is not Assignment.pick(candidates, choice)"

    def test_a_single_candidate_is_chosen(self, scene: Scene) -> None:
        """Nothing to choose from is no reason to fail."""
        all_: Candidates = some_candidates(scene)
        one = replace(
            all_, offsets_mm=all_.offsets_mm[:, :, :1], maps=all_.maps[:, :, :1], errors=all_.errors[:, :, :1]
        )
        found = self.stage.anneal(scene, one, np.random.default_rng(SEED))
        assert not found.choice.any(), "each facet has candidate 0 alone, and another was chosen"
