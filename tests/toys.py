"""A plugin of tiny stages that do no optics, so that specs, plans and runs can be tested in no time."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from magiclens import builtin
from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid
from magiclens.contract.hookspecs import hookimpl
from magiclens.contract.stages import Annealer, Exporter, Finisher, Integrator, Matcher, Progress, Renderer, silent
from magiclens.contract.units import Length, LengthOrPercent, relative
from magiclens.images.resample import resize
from magiclens.plan.registry import Plugin, Registry

CANDIDATES = 3


class ToyMatcher(Matcher):
    """Draws candidates at random."""

    type: ClassVar[str] = "toy"
    sweeps: int = Field(25, ge=1, le=100)
    window: LengthOrPercent = Field(relative("10%"))
    step: Length = Field("0.5mm", validate_default=True, gt=0)

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        shape = (scene.lens.facets, scene.lens.facets, CANDIDATES)
        progress(0.5)
        offsets = rng.normal(size=(*shape, 2)).astype(np.float32)
        errors = np.sort(rng.random(shape), axis=-1).astype(np.float32)
        return Candidates(offsets, np.ones((*shape, 3), np.float32), errors, {"matching_psnr_db": 20.0})

    def rematch(
        self, scene: Scene, candidates: Candidates, assignment: Assignment, built: HeightField, traced: FloatArray,
        progress: Progress = silent,
    ) -> Candidates:  # fmt: skip
        assert traced.shape == assignment.choice.shape
        return Candidates(candidates.offsets_mm + 1, candidates.maps, candidates.errors, {"rematched": 1.0})


class ToyAnnealer(Annealer):
    """Chooses at random."""

    type: ClassVar[str] = "toy"

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        choice = rng.integers(CANDIDATES, size=candidates.errors.shape[:2])
        return Assignment.pick(candidates, choice, {"energy_before": 2.0, "energy_after": 1.0})


class ToyIntegrator(Integrator):
    """Heights from offsets."""

    type: ClassVar[str] = "toy"

    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        m = scene.lens.microfacets + 1
        heights = np.broadcast_to(assignment.offsets_mm[..., :1, None] * 0.1, (*assignment.choice.shape, m, m))
        return HeightField(scene.lens, heights.astype(float), None, {"step_max_mm": float(np.ptp(heights))})


class ToyFinisher(Finisher):
    """Changes nothing."""

    type: ClassVar[str] = "toy"

    def finish(self, scene: Scene, solid: Solid, progress: Progress = silent) -> Solid:
        return Solid(solid.vertices, solid.faces, solid.grid, solid.eye_mm, {"volume_mm3": 1.0})


class ToyExporter(Exporter):
    """Writes the vertices' bytes."""

    type: ClassVar[str] = "toy"
    suffix: ClassVar[str] = ".toy"

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        path.write_bytes(np.asarray(solid.vertices).tobytes())


class ToyRenderer(Renderer):
    """Sees the targets, darker and blurred."""

    type: ClassVar[str] = "toy"

    def render(self, scene: Scene, solid: Solid, progress: Progress = silent) -> list[FloatArray]:
        return [0.9 * resize(resize(view.target, (16, 16)), (32, 32)) for view in scene.views]


class ToyTracer(ToyRenderer):
    """The same picture under the name of the reference renderer."""

    type: ClassVar[str] = "tracer"


TOYS = (ToyMatcher, ToyAnnealer, ToyIntegrator, ToyFinisher, ToyExporter, ToyRenderer, ToyTracer)
TOY_PLUGIN = Plugin("toys", "magiclens-toys", "1.2")


def plugin_of(*stages: object) -> object:
    """An object that contributes stages, as a plugin's module does."""
    return SimpleNamespace(mlens_stages=hookimpl(lambda: list(stages), specname="mlens_stages"))


def registry_of(*stages: object) -> Registry:
    """Built-in scenarios, art and executors, and only these stages."""
    registry = Registry()
    scenery = SimpleNamespace(
        mlens_scenarios=builtin.mlens_scenarios, mlens_art=builtin.mlens_art, mlens_executors=builtin.mlens_executors
    )
    registry.register(scenery, Plugin("builtin", "magiclens", "0.1.0"))
    registry.register(plugin_of(*stages), TOY_PLUGIN)
    assert registry.failures == []
    return registry


SPEC = """\
scenario:
  type: rotating
  source: {type: circles, seed: 7}
  targets: [{art: panda}, {art: bat}]
  angles: [0deg, 90deg]
lens:
  size: 20mm
  facets: 4
  microfacets: 2
viewer: {distance: 400mm}
pipeline:
  matcher:
    type: toy
    sweeps: 5
  annealer: {type: toy}
  integrator: {type: toy}
  finisher: {type: toy}
  exporters: [{type: toy}]
  renderers: [{type: tracer}]
"""

SpecWriter = Callable[..., Path]


def no_timings(manifest: dict[str, Any]) -> dict[str, Any]:
    """A manifest without its timings."""
    stages = [{k: v for k, v in stage.items() if k != "seconds"} for stage in manifest["stages"]]
    return {**{k: v for k, v in manifest.items() if k != "seconds"}, "stages": stages}


class Others:
    """Other machines, in this process; they note what they are given, which is sent there and back."""

    def __init__(self, blocks: int):
        self.blocks = blocks
        self.items: list[Any] = []
        self.functions: set[str] = set()

    def map(self, function: Callable[[Any, Any], Any], given: Any, items: Sequence[Any]) -> Iterator[Any]:
        self.items += items
        self.functions.add(function.__name__)
        return iter([_sent(_call(*_sent((function, given, item)))) for item in items])


def _sent(what: Any) -> Any:
    """What arrives on another machine."""
    return pickle.loads(pickle.dumps(what))


def _call(function: Callable[[Any, Any], Any], given: Any, item: Any) -> Any:
    return function(given, item)
