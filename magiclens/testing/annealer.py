"""The contract of annealers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, Scene
from magiclens.contract.checks import check_assignment
from magiclens.contract.stages import Annealer, Progress
from magiclens.testing.scenes import some_candidates
from magiclens.testing.stage import SEED, StageCall, StageContract, digest

_SLACK = 1e-9
"""Relative rise of the energy that is put down to rounding."""


class AnnealerContract(StageContract):
    """Checks that one of each facet's candidates is chosen, and that the energy does not rise."""

    stage: Annealer

    def inputs(self, scene: Scene) -> tuple[Any, ...]:
        """See StageContract."""
        return scene, some_candidates(scene)

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Assignment:
        """See StageContract."""
        scene, candidates = inputs
        return self.stage.anneal(scene, candidates, rng, progress)

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """See StageContract."""
        check_assignment(inputs[0].lens, inputs[1], artifact)

    def test_the_energy_is_never_worse(self, outcome: StageCall) -> None:
        """The metrics hold the energy of the best candidates and that of the chosen ones."""
        metrics = outcome.artifact.metrics
        assert {"energy_before", "energy_after"} <= set(metrics), "metrics needs energy_before and energy_after"
        before, after = metrics["energy_before"], metrics["energy_after"]
        assert after <= before + _SLACK * abs(before), f"the energy rose from {before:g} to {after:g}"

    def test_what_is_assigned_is_what_was_chosen(self, outcome: StageCall) -> None:
        """Offsets, maps and errors are copied from the candidates, as ``Assignment.pick`` does."""
        picked = Assignment.pick(outcome.inputs[1], outcome.artifact.choice, dict(outcome.artifact.metrics))
        assert digest(picked) == digest(outcome.artifact), "the assignment is not Assignment.pick(candidates, choice)"

    def test_a_single_candidate_is_chosen(self, scene: Scene) -> None:
        """A stage must not fail if there is nothing to choose from."""
        all_: Candidates = some_candidates(scene)
        one = replace(
            all_, offsets_mm=all_.offsets_mm[:, :, :1], maps=all_.maps[:, :, :1], errors=all_.errors[:, :, :1]
        )
        found = self.stage.anneal(scene, one, np.random.default_rng(SEED))
        assert not found.choice.any(), "each facet has candidate 0 alone, and another was chosen"
