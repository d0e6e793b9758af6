"""Designs a lens by a plan: from a scene to a closed mesh, and to painted sources if the plan has an encoder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, HeightField, Scene, Solid, Transport
from magiclens.contract.checks import check_assignment, check_candidates, check_encoded, check_height_field
from magiclens.contract.stages import KINDS
from magiclens.plan.compile import Plan
from magiclens.running.steps import Steps

Generators = dict[str, np.random.Generator]
"""One random generator for each kind of stage."""


def generators(seed: int) -> Generators:
    """One generator per kind of stage, so that a stage that draws more numbers does not change what others draw."""
    # by the place in KINDS: a new kind must come last, or the other kinds would draw other numbers
    children = np.random.SeedSequence(seed).spawn(len(KINDS))
    return {kind: np.random.default_rng(child) for kind, child in zip(KINDS, children, strict=True)}


@dataclass(frozen=True)
class Shape:
    """The top of a lens, and the candidates and choices that it was built from.

    Attributes:
        candidates: What the matcher found, or corrected when it matched again.
        assignment: What the annealer chose among them.
        height_field: What the integrator made of that.
    """

    candidates: Candidates
    assignment: Assignment
    height_field: HeightField


class Designer:
    """Designs lenses by one plan. Its generators go on from lens to lens, so the order of calls matters."""

    def __init__(self, plan: Plan, steps: Steps):
        self._plan, self._steps = plan, steps
        self._rng = generators(plan.spec.seed)

    def design(self, scene: Scene) -> tuple[Shape, Solid]:
        """Match, anneal, integrate, rematch and refine, then mesh.

        Args:
            scene: The views as the medium shows them. A matcher that uses no pictures gets none.

        Returns:
            The shape, and its closed mesh before any finisher.
        """
        from magiclens.geometry.solid import solid_from_heights

        plan, matcher = self._plan, self._plan.matcher.stage
        # so no stage can depend on pictures by accident: a universal lens is the same whatever it will show
        scene = scene if matcher.uses_pictures else blank_scene(scene)
        match = partial(matcher.match, scene, self._rng["matcher"])
        candidates = self._steps.stage(plan.matcher, match, partial(check_candidates, plan.lens))
        shape = self._build(scene, candidates)
        if plan.spec.pipeline.rematch:
            shape = self._rematch(scene, shape)
        if matcher.uses_pictures:
            refine = partial(plan.integrator.stage.refine, scene, shape.height_field)
            refined = self._steps.stage(plan.integrator, refine, partial(check_height_field, plan.lens))
            shape = replace(shape, height_field=refined)
        return shape, self._steps.part("meshing", partial(solid_from_heights, shape.height_field))

    def transports(self, scene: Scene, solid: Solid) -> list[Transport]:
        """One matrix per view, traced; none if the plan has no encoder, which alone needs them."""
        from magiclens.rendering.transports import transports

        return self._steps.part("tracing", partial(transports, scene, solid)) if self._plan.encoder else []

    def encode(self, given: Scene, transports: list[Transport]) -> Scene:
        """The scene with sources painted for a traced lens, or as given if the plan has no encoder.

        Args:
            given: The scene with the sources of the spec. Painting always starts from these, even in later rounds.
            transports: One matrix per view, see ``transports``.
        """
        step = self._plan.encoder
        if step is None:
            return given
        encode = partial(step.stage.encode, given, transports, self._rng["encoder"])
        painted: Scene = self._steps.stage(step, encode, partial(check_encoded, given))
        return painted

    def _build(self, scene: Scene, candidates: Candidates) -> Shape:
        """Choose among candidates and build what was chosen."""
        plan = self._plan
        anneal = partial(plan.annealer.stage.anneal, scene, candidates, self._rng["annealer"])
        assignment = self._steps.stage(plan.annealer, anneal, partial(check_assignment, plan.lens, candidates))
        integrate = partial(plan.integrator.stage.integrate, scene, assignment)
        built = self._steps.stage(plan.integrator, integrate, partial(check_height_field, plan.lens))
        return Shape(candidates, assignment, built)

    def _rematch(self, scene: Scene, best: Shape) -> Shape:
        """Rounds of rematching, annealing and integration while the traced error falls (4.6, last paragraph)."""
        from magiclens.rendering.facet_errors import facet_errors

        plan, steps = self._plan, self._steps
        errors = steps.part("tracing", partial(facet_errors, scene, best.height_field))
        for _ in range(plan.spec.pipeline.rematch):
            rematch = partial(
                plan.matcher.stage.rematch, scene, best.candidates, best.assignment, best.height_field, errors
            )
            trial = self._build(scene, steps.stage(plan.matcher, rematch, partial(check_candidates, plan.lens)))
            trial_errors = steps.part("tracing", partial(facet_errors, scene, trial.height_field))
            # a round that helps nothing is thrown away; further ones would start from the same lens and the same errors
            if trial_errors.mean() >= errors.mean():
                break
            best, errors = trial, trial_errors
        return best


def blank_scene(scene: Scene) -> Scene:
    """The scene with white sources and black targets of one pixel: light lost at a wall counts the same everywhere."""
    white, black = np.ones((1, 1, 1), np.float32), np.zeros((1, 1, 1), np.float32)
    return replace(scene, views=tuple(replace(view, source=white, target=black) for view in scene.views))
