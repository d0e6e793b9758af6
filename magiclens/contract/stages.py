"""The contracts of the stages, in the order of the pipeline.

A stage is a pydantic model: its fields are its options, and so the keys of its mapping in a spec. A subclass sets
``type``, the name that picks it, and implements the one abstract method of its kind. Stages are pure: they get
read-only artifacts and return new ones, and equal inputs give equal outputs. Only exporters write files. A stage that
needs random numbers draws them from the generator that it is given.

Shapes and frames are those of ``magiclens.contract.artifacts``. Stages raise an InputError when the user has asked for
something impossible, a StageError when they fail. A stage must not import what takes time to load (numba, scipy) before
its method is called, since all stages are imported to list them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Lens, Scene, Solid, Transport

Progress = Callable[[float], None]
"""A function that long stages call with the fraction of the work that is done, from 0 to 1, never descending."""


def silent(_: float) -> None:
    """Report progress to nobody: the default of every stage."""


class Stage(BaseModel, ABC):
    """Base of all stages.

    Attributes:
        kind: The place in the pipeline, such as ``matcher``; set by the base class of the kind.
        type: The name that picks the stage in a spec, such as ``exhaustive``.
        version: Part of a run's identity; raise it when equal inputs give other results.
        repeatable: Whether equal inputs give equal results, so that results are kept and used again. A stage that asks
            a clock, a network or a person sets it to False; it is done in every run then.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)

    kind: ClassVar[str]
    type: ClassVar[str]
    version: ClassVar[str] = "1"
    repeatable: ClassVar[bool] = True

    def surroundings(self) -> object:
        """What results depend on besides options, inputs and code, such as a library that a machine may lack.

        Returns:
            Numbers and text, in lists and mappings if need be; results that were kept are used where it is the same.
            It is asked for before every run, so it must be quick.
        """
        return None

    def lacks(self) -> str | None:
        """What the stage needs and this machine does not have, such as a library, and what to do about it.

        Returns:
            A sentence; None if nothing is lacking. It is asked for before every run, so it must be quick.
        """
        return None


class Matcher(Stage):
    """Finds, for every facet, patches of the source that resemble its tile of the target (4.2).

    Attributes:
        uses_pictures: Whether the lens depends on pictures. It does not for universal lenses (5): then no stage that
            shapes the lens is given any.
    """

    kind: ClassVar[str] = "matcher"
    uses_pictures: ClassVar[bool] = True

    @abstractmethod
    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        """Find candidates.

        Args:
            scene: The lens and what it must show.
            rng: The source of randomness, spawned from the spec's seed.
            progress: Told the fraction that is done.

        Returns:
            At least one candidate per facet, best first. Candidates that refraction cannot reach, or not within the
            lens's slope limit, are left out.

        Raises:
            InputError: Some facet has no candidate at all.
        """

    def rematch(
        self, scene: Scene, candidates: Candidates, assignment: Assignment, built: HeightField, traced: FloatArray,
        progress: Progress = silent,
    ) -> Candidates:  # fmt: skip
        """Correct candidates by what the lens, once it is built, really shows (4.6, last paragraph).

        By default, the candidates that were chosen get the traced errors, so that those which steps, walls or the true
        shapes of lenslets have spoilt lose against others.

        Args:
            scene: The lens and what it must show.
            candidates: The candidates before.
            assignment: Those of them that were chosen.
            built: The height field that was made from the assignment.
            traced: Mean squared difference, in display values, of each facet's traced picture and its tile: (N, N).
            progress: Told the fraction that is done.

        Returns:
            Candidates in the same order as before, even if their errors no longer ascend, so that the index of a
            candidate means the same in every round.
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
        """Choose candidates.

        Args:
            scene: The lens and what it must show.
            candidates: What to choose from; those with an error of inf do not exist.
            rng: The source of randomness, spawned from the spec's seed.
            progress: Told the fraction that is done.

        Returns:
            One candidate per facet. Its metrics hold ``energy_before`` and ``energy_after``, of the best candidates and
            of the chosen ones; the energy (eqs 3 and 4 in the paper) is the annealer's own, but must not rise.
        """


class Integrator(Stage):
    """Turns chosen transformations into heights, iterating orientation (4.3) and integration (4.5).

    Attributes:
        goes_on: Whether ``refine`` may be given what it has made, for an edited source. Co-design then shapes one lens
            further and further, instead of designing another one in every round.
    """

    kind: ClassVar[str] = "integrator"

    @abstractmethod
    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        """Make the top of the lens.

        Args:
            scene: The lens and what it must show.
            assignment: The transformation that each facet shall have.
            progress: Told the fraction that is done.

        Returns:
            Heights within the lens's relief and slope limits.

        Raises:
            StageError: Some facet cannot be made; the message names it.
        """

    @property
    def goes_on(self) -> bool:
        """See ``Integrator``."""
        return False

    def refine(self, scene: Scene, built: HeightField, progress: Progress = silent) -> HeightField:
        """Improve the final height field by what all eyes see through it; by default, it stays as it is.

        This is called before meshing, and only if the matcher uses pictures.

        Args:
            scene: The lens and what it must show.
            built: The height field of the final assignment.
            progress: Told the fraction that is done.

        Returns:
            Heights within the same limits.
        """
        return built


class Finisher(Stage):
    """Repairs, smooths or checks the mesh."""

    kind: ClassVar[str] = "finisher"

    @abstractmethod
    def finish(self, scene: Scene, solid: Solid, progress: Progress = silent) -> Solid:
        """Make the solid that is exported.

        Args:
            scene: The lens and what it must show.
            solid: The closed mesh of the height field.
            progress: Told the fraction that is done.

        Returns:
            A closed solid that can be fabricated and shows the same. It keeps ``grid`` if its vertices still are one.
            Its metrics hold what was measured.
        """


class Encoder(Stage):
    """Paints or edits the sources so that the finished lens shows the targets (5.2, and the continuum of 7)."""

    kind: ClassVar[str] = "encoder"

    @abstractmethod
    def encode(
        self, scene: Scene, transports: Sequence[Transport], rng: np.random.Generator, progress: Progress = silent
    ) -> Scene:
        """Paint the sources.

        Args:
            scene: The lens, what it must show, and the sources to start from. Pixels in ``scene.reserved`` must stay.
            transports: For each view, the matrix from its source to its picture, both in the world frame.
            rng: The source of randomness, spawned from the spec's seed.
            progress: Told the fraction that is done.

        Returns:
            The scene with other sources, of the same sizes and within 0 to 1. Views that share a source still do, and
            everything else is the same.
        """


class Exporter(Stage):
    """Writes a solid to a file that other programs read.

    Attributes:
        suffix: The ending of the file, such as ``.stl``.
    """

    kind: ClassVar[str] = "exporter"
    suffix: ClassVar[str]

    def require_possible(self, lens: Lens) -> None:
        """Find out whether a lens can be exported at all. It is asked before every run, so it must be quick.

        Args:
            lens: Its sizes and limits; nothing of it has been designed.

        Raises:
            InputError: No such lens can be, whatever it will show; its ``keys`` name the options at fault.
        """

    @abstractmethod
    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the file; equal inputs give equal bytes, so it holds no date.

        Args:
            scene: The lens and what it must show.
            solid: The finished solid.
            path: The file, which ends in ``suffix``. More files may be written beside it if their names start in the
                same way.
        """


class Renderer(Stage):
    """Simulates what the eye of each view sees through the finished solid."""

    kind: ClassVar[str] = "renderer"

    @abstractmethod
    def render(self, scene: Scene, solid: Solid, progress: Progress = silent) -> list[FloatArray]:
        """Take a simulated photograph of every view.

        Args:
            scene: The lens, the sources and the eyes.
            solid: The finished solid.
            progress: Told the fraction that is done.

        Returns:
            A picture per view, of a resolution R of the renderer's own: (R, R, C) float32, linear light, world frame.
            It shows the lens's square on the reference plane, as targets do.
        """


KINDS: dict[str, type[Stage]] = {
    cls.kind: cls for cls in (Matcher, Annealer, Integrator, Finisher, Encoder, Exporter, Renderer)
}
"""Every kind of stage, in pipeline order."""
