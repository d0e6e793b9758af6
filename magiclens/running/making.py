"""Everything that stages do in a run: the lens is designed, finished, rendered and exported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from magiclens.cache.store import Cache
from magiclens.contract.artifacts import (
    Assignment,
    Candidates,
    FloatArray,
    HeightField,
    Scene,
    Solid,
    Transport,
)
from magiclens.contract.checks import check_pictures, check_solid
from magiclens.contract.result import RunResult
from magiclens.contract.stages import Renderer
from magiclens.plan.compile import Plan, Step
from magiclens.running.design import Designer
from magiclens.running.folder import save_heights
from magiclens.running.ingredients import Kept
from magiclens.running.observers import Observer
from magiclens.running.steps import QuietSteps, Steps
from magiclens.running.writing import (
    save_transports,
    write_animations,
    write_renders,
    write_scene_pictures,
    write_sources,
)

Renders = dict[str, Kept[list[FloatArray]]]
"""One picture (R, R, C) per view, linear light, by renderer type."""


@dataclass(frozen=True)
class Drafts:
    """What stages make in a run, each result there when it is asked for; names are those of ``RunResult``."""

    given: Kept[Scene]
    painted: Kept[Scene]
    scene: Kept[Scene]
    candidates: Kept[Candidates]
    assignment: Kept[Assignment]
    height_field: Kept[HeightField]
    unfinished: Kept[Solid]
    solid: Kept[Solid]
    transports: Kept[list[Transport]]
    renders: Renders

    @property
    def each(self) -> dict[str, Kept[object]]:
        """All of them by name, each renderer's pictures by themselves."""
        single = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "renders"}
        return {**single, **{f"renders {name}": pictures for name, pictures in self.renders.items()}}

    def result(self, plan: Plan, cache: Cache | None) -> RunResult:
        """The same as values, without a manifest."""
        return RunResult(
            given=self.given.value,
            painted=self.painted.value,
            scene=self.scene.value,
            candidates=self.candidates.value,
            assignment=self.assignment.value,
            height_field=self.height_field.value,
            unfinished=self.unfinished.value,
            solid=self.solid.value,
            renders={name: pictures.value for name, pictures in self.renders.items()},
            transports=_Later(self.transports),
            redesign=partial(_redesign, plan, cache),
        )


def make_lens(plan: Plan, given: Kept[Scene], folder: Path, steps: Steps) -> Drafts:
    """Design the lens, and the painted sources if there is an encoder; render it.

    Args:
        plan: What to run.
        given: The scene that the spec describes.
        folder: The run folder, for all files.
        steps: Does the steps.
    """
    designer = Designer(plan, steps, given)
    shape, unfinished = designer.design(given)
    # while lens and sources change in turns the mesh need not be finished: only the last one is exported
    for _ in range(plan.spec.pipeline.codesign):
        painted = designer.encode(designer.transports(unfinished))
        shape, unfinished = designer.redesign(painted, shape)
    solid = steps.stage(plan.finisher, "finish", {"scene": given, "solid": unfinished}, check_solid)
    transports = designer.transports(solid)
    painted = designer.encode(transports)
    files = _Files(plan, folder, steps)
    files.scene(given, painted)
    files.heights(solid)
    files.matrices(given, transports)
    scene, renders = designer.shown(painted), Renders()
    for renderer in plan.renderers:
        renders[renderer.stage.type] = _rendered(renderer, scene, solid, steps)
        files.renders(renderer.stage.type, scene, renders[renderer.stage.type])
    files.animations(painted, renders)
    return Drafts(
        given=given,
        painted=painted,
        scene=scene,
        candidates=shape.candidates,
        assignment=shape.assignment,
        height_field=shape.height_field,
        unfinished=unfinished,
        solid=solid,
        transports=transports,
        renders=renders,
    )


def export_lens(plan: Plan, made: Drafts, folder: Path, steps: Steps) -> None:
    """Write the files of all exporters into a run folder."""
    for exporter in plan.exporters:
        steps.export(exporter, made.painted, made.solid, folder)


def _rendered(step: Step[Renderer], scene: Kept[Scene], solid: Kept[Solid], steps: Steps) -> Kept[list[FloatArray]]:
    def check(found: object) -> None:
        check_pictures(scene.value, found)

    return steps.stage(step, "render", {"scene": scene, "solid": solid}, check)


class _Later(Sequence[Transport]):
    """Matrices that are traced when somebody looks at them: few analyses do, and it takes long."""

    def __init__(self, kept: Kept[list[Transport]]):
        self._kept = kept

    def __len__(self) -> int:
        return len(self._kept.value)

    def __getitem__(self, index: Any) -> Any:
        return self._kept.value[index]

    def __reduce__(self) -> tuple[type[Any], tuple[Any, ...]]:
        """Pickle the matrices, since what is not there yet cannot be pickled."""
        return list, (self._kept.value,)


def _redesign(plan: Plan, cache: Cache | None, given: Scene) -> tuple[Scene, Solid]:
    """Design another scene by the same plan and seed, without hooks and progress; see ``RunResult.redesign``."""
    steps = QuietSteps(plan, Observer(), cache)
    kept = steps.known(given)
    designer = Designer(plan, steps, kept)
    _, solid = designer.design(kept)
    return designer.shown(designer.encode(designer.transports(solid))).value, solid.value


class _Files:
    """Writes what stages have made into the run folder, unless the cache has these files."""

    def __init__(self, plan: Plan, folder: Path, steps: Steps):
        self._plan, self._folder, self._steps = plan, folder, steps

    def scene(self, given: Kept[Scene], painted: Kept[Scene]) -> None:
        """The sources, as they are to be printed and as they were given, and the targets."""

        def write(folder: Path) -> None:
            write_scene_pictures(painted.value, folder)
            if self._plan.encoder:
                write_sources(given.value, folder, "given")

        made_of = self._steps.made_of("sources and targets", {"given": given, "painted": painted})
        self._steps.files("sources and targets", made_of, self._folder, write, shown=False)

    def heights(self, solid: Kept[Solid]) -> None:
        """The top of the lens, if it still is a grid."""
        lens = self._plan.lens
        made_of = self._steps.made_of("heights", {"lens": self._steps.known(lens), "solid": solid})
        write = lambda folder: save_heights(solid.value, lens, folder)  # noqa: E731
        self._steps.files("heights", made_of, self._folder, write, shown=False)

    def matrices(self, given: Kept[Scene], transports: Kept[list[Transport]]) -> None:
        """What every eye sees of each pixel of its source, if the plan has an encoder."""
        if not self._plan.encoder:
            return

        def write(folder: Path) -> None:
            made = transports.value  # which has a time of its own
            self._steps.part("matrices", partial(save_transports, given.value, made, folder))

        made_of = self._steps.made_of("matrices", {"given": given, "transports": transports})
        self._steps.files("matrices", made_of, self._folder, write)

    def renders(self, renderer: str, scene: Kept[Scene], pictures: Kept[list[FloatArray]]) -> None:
        """The pictures of a renderer."""
        made_of = self._steps.made_of("renders", {"renderer": renderer, "scene": scene, "pictures": pictures})
        write = lambda folder: write_renders(renderer, scene.value, pictures.value, folder)  # noqa: E731
        self._steps.files("renders", made_of, self._folder, write, shown=False)

    def animations(self, painted: Kept[Scene], renders: Mapping[str, Kept[list[FloatArray]]]) -> None:
        """The views one after the other, if they are the frames of an animation."""
        fps = self._plan.scenario.frames_per_second
        if not (fps and renders):
            return
        seen = next(iter(renders.values()))

        def write(folder: Path) -> None:
            work = partial(write_animations, painted.value, fps, seen.value, folder)
            self._steps.part("animations", work)

        made_of = self._steps.made_of("animations", {"fps": fps, "painted": painted, "seen": seen})
        self._steps.files("animations", made_of, self._folder, write)
