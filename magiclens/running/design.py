"""Designs a lens by a plan: from a scene to a closed mesh, and to painted sources if the plan has an encoder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid, Transport
from magiclens.contract.checks import check_assignment, check_candidates, check_encoded, check_height_field
from magiclens.contract.stages import KINDS
from magiclens.plan.compile import Plan
from magiclens.running.ingredients import Kept
from magiclens.running.steps import Draws, Steps

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

    candidates: Kept[Candidates]
    assignment: Kept[Assignment]
    height_field: Kept[HeightField]


class Designer:
    """Designs lenses by one plan. Its generators go on from lens to lens, so the order of calls matters."""

    def __init__(self, plan: Plan, steps: Steps, given: Kept[Scene]):
        """``given`` is the scene with the sources of the spec."""
        self._plan, self._steps, self._given = plan, steps, given
        self._draws = {kind: Draws(rng) for kind, rng in generators(plan.spec.seed).items()}

    def design(self, painted: Kept[Scene]) -> tuple[Shape, Kept[Solid]]:
        """Match, anneal, integrate, rematch and refine, then mesh.

        Args:
            painted: The scene with the sources to design for. A matcher that uses no pictures gets none.

        Returns:
            The shape, and its closed mesh before any finisher.
        """
        plan, matcher = self._plan, self._plan.matcher.stage
        scene = self.shown(painted)
        if not matcher.uses_pictures:
            # so no stage can depend on pictures by accident: a universal lens is the same whatever it will show
            scene = self._steps.known(blank_scene(self._given.value))
        check = partial(check_candidates, plan.lens)
        candidates = self._steps.stage(plan.matcher, "match", {"scene": scene}, check, self._draws["matcher"])
        shape = self._build(scene, candidates)
        if plan.spec.pipeline.rematch:
            shape = self._rematch(scene, shape)
        return self._refine(scene, shape) if matcher.uses_pictures else (shape, self._meshed(shape))

    def redesign(self, painted: Kept[Scene], shape: Shape) -> tuple[Shape, Kept[Solid]]:
        """Design for edited sources: the shape refined further where that is possible, otherwise another one.

        Args:
            painted: The scene with the sources to design for.
            shape: What was designed for the sources before.
        """
        matcher, integrator = self._plan.matcher.stage, self._plan.integrator.stage
        if matcher.uses_pictures and integrator.goes_on:
            return self._refine(self.shown(painted), shape)
        return self.design(painted)

    def shown(self, painted: Kept[Scene]) -> Kept[Scene]:
        """The scene as the medium of the plan shows it."""
        medium = self._plan.spec.medium
        if medium is None:
            return painted
        how = self._steps.known(medium.model_dump(mode="json"))
        show = lambda scene, _: self._plan.on_medium(scene)  # noqa: E731
        return self._steps.derived("medium", show, shown=False, scene=painted, medium=how)

    def transports(self, solid: Kept[Solid]) -> Kept[list[Transport]]:
        """One matrix per view, of the lens as it is made; none if the plan has no encoder, which alone needs them."""
        if self._plan.encoder is None:
            return self._steps.known([])
        from magiclens.rendering.transports import transports
        from magiclens.simulation.as_made import body_of

        making = self._plan.fabrication
        if making is None:
            return self._steps.derived("tracing", transports, scene=self._given, solid=solid)
        trace = lambda scene, solid, machine: transports(scene, body_of(solid, making.machine))  # noqa: E731
        how = self._steps.known(making.machine.model_dump(mode="json"))
        return self._steps.derived("tracing", trace, scene=self._given, solid=solid, machine=how)

    def encode(self, transports: Kept[list[Transport]]) -> Kept[Scene]:
        """The scene with sources painted for a traced lens, or as given if the plan has no encoder.

        Painting always starts from the sources of the spec, even in later rounds.

        Args:
            transports: One matrix per view, see ``transports``.
        """
        step = self._plan.encoder
        if step is None:
            return self._given
        inputs = {"scene": self._given, "transports": transports}
        check = lambda found: check_encoded(self._given.value, found)  # noqa: E731
        return self._steps.stage(step, "encode", inputs, check, self._draws["encoder"])

    def _refine(self, scene: Kept[Scene], shape: Shape) -> tuple[Shape, Kept[Solid]]:
        inputs = {"scene": scene, "built": shape.height_field}
        check = partial(check_height_field, self._plan.lens)
        refined = self._steps.stage(self._plan.integrator, "refine", inputs, check)
        shape = replace(shape, height_field=refined)
        return shape, self._meshed(shape)

    def _meshed(self, shape: Shape) -> Kept[Solid]:
        from magiclens.geometry.solid import solid_from_heights

        return self._steps.derived("meshing", solid_from_heights, height_field=shape.height_field)

    def _build(self, scene: Kept[Scene], candidates: Kept[Candidates]) -> Shape:
        """Choose among candidates and build what was chosen."""
        plan = self._plan
        inputs = {"scene": scene, "candidates": candidates}
        check = lambda found: check_assignment(plan.lens, candidates.value, found)  # noqa: E731
        assignment = self._steps.stage(plan.annealer, "anneal", inputs, check, self._draws["annealer"])
        chosen = {"scene": scene, "assignment": assignment}
        built = self._steps.stage(plan.integrator, "integrate", chosen, partial(check_height_field, plan.lens))
        return Shape(candidates, assignment, built)

    def _rematch(self, scene: Kept[Scene], best: Shape) -> Shape:
        """Rounds of rematching, annealing and integration while the traced error falls (4.6, last paragraph)."""
        plan, steps = self._plan, self._steps
        errors = self._errors(scene, best)
        for _ in range(plan.spec.pipeline.rematch):
            inputs = {
                "scene": scene, "candidates": best.candidates, "assignment": best.assignment,
                "built": best.height_field, "traced": errors,
            }  # fmt: skip
            candidates = steps.stage(plan.matcher, "rematch", inputs, partial(check_candidates, plan.lens))
            trial = self._build(scene, candidates)
            trial_errors = self._errors(scene, trial)
            # a round that helps nothing is thrown away; further ones would start from the same lens and the same errors
            if not steps.holds(partial(_less, trial_errors, errors)):
                break
            best, errors = trial, trial_errors
        return best

    def _errors(self, scene: Kept[Scene], shape: Shape) -> Kept[FloatArray]:
        """The traced error of every facet: (N, N)."""
        from magiclens.rendering.facet_errors import facet_errors

        return self._steps.measured("tracing", facet_errors, scene=scene, height_field=shape.height_field)


def _less(errors: Kept[FloatArray], others: Kept[FloatArray]) -> bool:
    """Whether errors are smaller on average than others."""
    return bool(errors.value.mean() < others.value.mean())


def blank_scene(scene: Scene) -> Scene:
    """The scene with white sources and black targets of one pixel: light lost at a wall counts the same everywhere."""
    white, black = np.ones((1, 1, 1), np.float32), np.zeros((1, 1, 1), np.float32)
    return replace(scene, views=tuple(replace(view, source=white, target=black) for view in scene.views))
