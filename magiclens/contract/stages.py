"""The contracts of the pipeline's stages, in pipeline order.

A stage is a pydantic model: its fields are its options, and so the keys of its YAML mapping. A subclass sets
``type`` (the name a spec picks it by) and implements one method. Stages are pure: they get read-only artifacts and
return new ones. Only exporters write files. Randomness is an argument.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid, Transport

Progress = Callable[[float], None]
"""Called by long stages with the fraction that is done, from 0 to 1."""


def silent(_: float) -> None:
    """The progress callback that reports nowhere."""


class Stage(BaseModel, ABC):
    """Base of all stages. ``version`` is part of a run's identity: raise it when results change."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    kind: ClassVar[str]
    type: ClassVar[str]
    version: ClassVar[str] = "1"


class Matcher(Stage):
    """Finds, for every facet, source patches that look like its tile of the target (4.2).

    ``uses_pictures`` is False for universal lenses (5): then no stage that shapes the lens is given any picture.
    """

    kind: ClassVar[str] = "matcher"
    uses_pictures: ClassVar[bool] = True

    @abstractmethod
    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Candidates per facet, best first; those that refraction cannot reach are left out."""

    def rematch(
        self, scene: Scene, candidates: Candidates, assignment: Assignment, built: HeightField, traced: FloatArray,
        progress: Progress = silent,
    ) -> Candidates:  # fmt: skip
        """Candidates corrected by what the lens, as ``built`` from the assignment, really shows (4.6, last paragraph).

        traced: (N, N) mean squared difference, in display values, of each facet's traced picture and its tile. Unless
        a matcher knows better, the candidates in use get these errors, so that those which steps, walls or the
        lenslets' true shapes have spoilt lose against others. The lists stay in order, so that a candidate's number
        means the same in every round.
        """
        errors = candidates.errors.copy()
        i, j = np.indices(assignment.choice.shape)
        errors[i, j, assignment.choice] = traced
        return replace(candidates, errors=errors)


class Annealer(Stage):
    """Chooses one candidate per facet so that neighbouring facets fit together (4.4)."""

    kind: ClassVar[str] = "annealer"

    @abstractmethod
    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        """One candidate per facet. ``metrics`` holds ``energy_before`` and ``energy_after``."""


class Integrator(Stage):
    """Turns chosen transformations into heights, iterating orientation (4.3) and integration (4.5)."""

    kind: ClassVar[str] = "integrator"

    @abstractmethod
    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        """A height field within the lens's relief and slope limits. Raises StageError naming a facet that cannot be."""

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        """The height field that goes on to be meshed: a better one, within the same limits, if it knows how.

        built: from the final assignment. Called once, at the end, and only if the matcher looks at the pictures.
        """
        return built


class Finisher(Stage):
    """Repairs, smooths or checks the closed mesh."""

    kind: ClassVar[str] = "finisher"

    @abstractmethod
    def finish(self, scene: Scene, solid: Solid, progress: Progress = silent) -> Solid:
        """A solid that is fit for fabrication; ``metrics`` holds the findings."""


class Encoder(Stage):
    """Paints or edits the sources so that the finished lens shows the targets (5.2; the continuum of 7)."""

    kind: ClassVar[str] = "encoder"

    @abstractmethod
    def encode(
        self, scene: Scene, transports: Sequence[Transport], rng: np.random.Generator, progress: Progress = silent
    ) -> Scene:
        """The scene with other sources; views that share a source go on sharing one. Everything else is unchanged.

        transports: one per view, the matrix from the view's source raster to its picture, both in the world frame.
        """


class Exporter(Stage):
    """Writes a solid to a file that other programs read."""

    kind: ClassVar[str] = "exporter"
    suffix: ClassVar[str]

    @abstractmethod
    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the file ``path`` (it ends in ``suffix``). Equal inputs give equal bytes."""


class Renderer(Stage):
    """Simulates what the eye of each view sees through the finished solid."""

    kind: ClassVar[str] = "renderer"

    @abstractmethod
    def render(self, scene: Scene, solid: Solid, progress: Progress = silent) -> list[FloatArray]:
        """One picture per view, (R, R, C) float32, linear light, world frame: the square on the reference plane."""


KINDS: dict[str, type[Stage]] = {
    cls.kind: cls for cls in (Matcher, Annealer, Integrator, Finisher, Encoder, Exporter, Renderer)
}
"""Every kind of stage, in pipeline order."""
