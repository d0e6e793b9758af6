"""What a run has made: the input of every analysis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid, Transport


@dataclass(frozen=True, eq=False)
class RunResult:
    """Everything that a run has made. Equal plans give equal results.

    Attributes:
        given: The scene that the spec describes.
        painted: The same with the sources that an encoder has painted; ``given`` itself if there is no encoder.
        scene: ``painted`` as the medium (paper or screen) shows it, which is what renderers see.
        candidates: What the matcher found.
        assignment: What the annealer chose among the candidates.
        height_field: The top of the lens before meshing.
        unfinished: The closed mesh before the finisher.
        solid: The finished mesh, the one that is exported.
        renders: By renderer type, one picture per view, (R, R, C) float32, linear light.
        transports: One matrix per view if the plan has an encoder, else none.
        redesign: Designs another scene by the same plan and seed; returns it as ``scene`` and its ``unfinished`` mesh.
        manifest: What ``manifest.json`` will say, but for timings and files; empty while analyses are computed, and
            ``metrics`` alone while they draw their figures.
    """

    given: Scene
    painted: Scene
    scene: Scene
    candidates: Candidates
    assignment: Assignment
    height_field: HeightField
    unfinished: Solid
    solid: Solid
    renders: Mapping[str, Sequence[FloatArray]]
    transports: Sequence[Transport] = ()
    redesign: Callable[[Scene], tuple[Scene, Solid]] | None = None
    manifest: Mapping[str, Any] = field(default_factory=dict)

    @property
    def best_match(self) -> Assignment:
        """The candidate with the least error of every facet, which is where annealing starts."""
        return Assignment.pick(self.candidates, self.candidates.errors.argmin(axis=-1))
