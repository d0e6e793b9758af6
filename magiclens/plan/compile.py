"""From a spec and the registry to a frozen plan: every stage chosen, every option known, every mistake found."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from magiclens.config.checker import Checker
from magiclens.config.document import Document, Keys, read_document
from magiclens.config.fabrication import Fabrication, find_fabrication
from magiclens.config.fields import Context, Inputs
from magiclens.config.load import check_spec
from magiclens.config.model import DEFAULT_STAGES, Choice, PipelineSpec, Spec
from magiclens.config.suggest import advice, unknown
from magiclens.contract.artifacts import Lens, Scene
from magiclens.contract.stages import Annealer, Encoder, Exporter, Finisher, Integrator, Matcher, Renderer, Stage
from magiclens.plan.registry import ART, SCENARIO, STAGE, Plugin, Registry, blaming
from magiclens.scenarios.base import Scenario, Shot

S = TypeVar("S", bound=Stage)
LISTS = {"exporters": "exporter", "renderers": "renderer"}
"""Keys of the pipeline that take several stages, and their kind."""


@dataclass(frozen=True)
class Step(Generic[S]):
    """A stage that a spec chose, with its options, and the plugin it comes from."""

    stage: S
    plugin: Plugin

    @property
    def name(self) -> str:
        """Kind and type, such as ``matcher exhaustive``."""
        return f"{self.stage.kind} {self.stage.type}"

    def __str__(self) -> str:
        return f"{self.name} ({self.plugin})"

    def choice(self, inputs: Inputs | None = None) -> dict[str, Any]:
        """The stage as a spec writes it, every option explicit."""
        with blaming(str(self)):
            return {"type": self.stage.type, **self.stage.model_dump(mode="json", context={"inputs": inputs})}


@dataclass(frozen=True)
class Plan:
    """Everything a run does, in pipeline order."""

    spec: Spec
    lens: Lens
    scenario: Scenario
    scenario_plugin: Plugin
    matcher: Step[Matcher]
    annealer: Step[Annealer]
    integrator: Step[Integrator]
    finisher: Step[Finisher]
    encoder: Step[Encoder] | None
    exporters: tuple[Step[Exporter], ...]
    renderers: tuple[Step[Renderer], ...]
    fabrication: Fabrication | None
    registry: Registry = field(repr=False, compare=False)

    @property
    def steps(self) -> tuple[Step[Any], ...]:
        """All stages, in pipeline order."""
        single = (self.matcher, self.annealer, self.integrator, self.finisher)
        return (*single, *([self.encoder] if self.encoder else []), *self.exporters, *self.renderers)

    def shots(self) -> tuple[Shot, ...]:
        """The views before they have pictures."""
        with blaming(f"scenario {self.scenario.type} ({self.scenario_plugin})"):
            return self.scenario.shots(self.lens, self.spec.viewer)

    def scene(self) -> Scene:
        """The lens and its views, pictures loaded."""
        with blaming(f"scenario {self.scenario.type} ({self.scenario_plugin})"):
            views = self.scenario.compiled(self.lens, self.spec.viewer, self.registry.art)
            return Scene(self.lens, views, self.scenario.reserved(self.lens, self.registry.art))

    def on_medium(self, scene: Scene) -> Scene:
        """The scene as paper or screen shows it: its sources, and its targets, which cannot be darker than its black.

        Light counts from the medium's white: the eye adapts to that, as the exposure does in scores. What is written to
        files, and what an encoder paints, keeps the full range: printing it does the mapping.
        """
        medium = self.spec.medium
        if medium is None:
            return scene
        sources = {view.source_name: medium.shown(view.source) for view in scene.views}
        views = (replace(v, source=sources[v.source_name], target=medium.shown(v.target)) for v in scene.views)
        return replace(scene, views=tuple(views))

    def resolved(self, inputs: Inputs | None = None) -> dict[str, Any]:
        """The spec with every default written out. ``inputs`` collects its files and makes their paths portable."""
        spec = self.spec.model_dump(mode="json", exclude_none=True)
        scenario = self.scenario.model_dump(mode="json", exclude_none=True, context={"inputs": inputs})
        several = {key: [step.choice(inputs) for step in getattr(self, key)] for key in LISTS}
        single = {s.stage.kind: s.choice(inputs) for s in self.steps if s.stage.kind not in LISTS.values()}
        rounds = {key: getattr(self.spec.pipeline, key) for key in ("rematch", "codesign")}
        making = {"fabrication": self.fabrication.resolved()} if self.fabrication else {}
        return {
            **spec,
            **making,
            "scenario": {"type": self.scenario.type, **scenario},
            "pipeline": {**single, **several, **rounds},
        }


def load_plan(path: str | Path, overrides: Iterable[str] = (), registry: Registry | None = None) -> Plan:
    """Read a spec, lay ``key.path=value`` overrides over it and compile it.

    Raises InputError naming the first mistake in file order, StageError when two packages claim a chosen stage.
    """
    return compile_plan(read_document(path, overrides), registry or Registry.load())


def compile_plan(document: Document, registry: Registry) -> Plan:
    """Resolve a document against the registry. Raises like ``load_plan``."""
    return _Compiler(document, registry).plan()


class _Compiler:
    """Resolves the parts of one document, whatever else is wrong with it, so that the first mistake can be named."""

    def __init__(self, document: Document, registry: Registry):
        self._document, self._registry = document, registry
        self._checker = Checker(document, Context(folder=document.folder, art=registry.types(ART)))
        self._fabrication = find_fabrication(document, self._checker)

    def plan(self) -> Plan:
        """The plan, or the first mistake."""
        spec = check_spec(self._document, self._checker, self._fabrication)
        scenario, scenario_plugin = self._scenario()
        suited = self._suited(scenario, scenario_plugin)
        if self._fabrication and spec:
            suited = self._fabrication.suited(suited, spec.lens.wall)
        steps = self._steps(suited)
        lens = self._fit(spec, scenario, scenario_plugin) if spec and scenario else None
        settle = self._checker.settle
        return Plan(
            spec=settle(spec),
            lens=settle(lens),
            scenario=settle(scenario),
            scenario_plugin=settle(scenario_plugin),
            matcher=settle(steps["matcher"][0]),
            annealer=settle(steps["annealer"][0]),
            integrator=settle(steps["integrator"][0]),
            finisher=settle(steps["finisher"][0]),
            encoder=next((settle(step) for step in steps["encoder"]), None),
            exporters=tuple(settle(step) for step in steps["exporters"]),
            renderers=tuple(settle(step) for step in steps["renderers"]),
            fabrication=self._fabrication,
            registry=self._registry,
        )

    def _scenario(self) -> tuple[Scenario, Plugin] | tuple[None, None]:
        written = self._document.data.get("scenario")
        choice: Choice = written if isinstance(written, dict) else {}
        found = self._pick(("scenario",), choice, SCENARIO)
        return (self._options(found, choice, ("scenario",), "key"), found[1]) if found else (None, None)

    def _steps(self, suited: Mapping[str, Choice]) -> dict[str, list[Step[Any] | None]]:
        """The stages at each key of the pipeline; None where something is wrong, nothing if the pipeline itself is."""
        pipeline = self._checker.validate(PipelineSpec, self._document.data.get("pipeline", {}), ("pipeline",))
        if pipeline is None:
            return defaultdict(lambda: [None])
        choices = {kind: pipeline.choice(kind, suited) for kind in (*DEFAULT_STAGES, Encoder.kind)}
        single = {k: [self._step(k, choice, ("pipeline", k))] if choice else [] for k, choice in choices.items()}
        several = {key: self._list(key, getattr(pipeline, key)) for key in LISTS}
        return {**single, **several}

    def _list(self, key: str, choices: list[Choice]) -> list[Step[Any] | None]:
        """The stages of a list; no two of them may write the same files."""
        steps = [self._step(LISTS[key], choice, ("pipeline", key, i)) for i, choice in enumerate(choices)]
        files = [_writes(step.stage) if step else None for step in steps]
        for i, file in enumerate(files):
            if file and file in files[:i]:
                self._checker.add(("pipeline", key, i), f"an earlier one writes {file} already; keep one of them")
        return steps

    def _step(self, kind: str, choice: Choice, at: Keys) -> Step[Any] | None:
        found = self._pick(at, choice, STAGE, kind)
        usual = self._machines(found[0]) if found and kind == Exporter.kind else {}
        stage = self._options(found, {**usual, **choice}, at, "option") if found else None
        return Step(stage, found[1]) if found and stage else None

    def _machines(self, exporter: type[Exporter]) -> Choice:
        """The options of an exporter that the machine decides."""
        usual = self._fabrication.machine.exporters().get(exporter.type, {}) if self._fabrication else {}
        return {key: value for key, value in usual.items() if key in exporter.model_fields}

    def _pick(self, at: Keys, choice: Choice, *table: str) -> tuple[type[Any], Plugin] | None:
        """The class that a mapping's ``type`` names, and its plugin."""
        if "type" not in choice:
            self._checker.add((*at, "type"), f"this key is required; {advice('', self._registry.types(*table))}")
            return None
        found = self._registry.find(*table, str(choice["type"]))
        if found is None:
            self._checker.add((*at, "type"), self._unknown(choice["type"], *table))
        return found

    def _unknown(self, type_: object, *table: str) -> str:
        hint = f" ({self._registry.absent})" if self._registry.absent else ""
        return unknown(table[-1], type_, self._registry.types(*table)) + hint

    def _options(self, found: tuple[type[Any], Plugin], choice: Choice, at: Keys, noun: str) -> Any:
        cls, plugin = found
        options = {key: value for key, value in choice.items() if key != "type"}
        with blaming(f"{getattr(cls, 'kind', SCENARIO)} {cls.type} ({plugin})"):
            return self._checker.validate(cls, options, at, noun)

    def _suited(self, scenario: Scenario | None, plugin: Plugin | None) -> dict[str, Choice]:
        if scenario is None:
            return {}
        with blaming(f"scenario {scenario.type} ({plugin})"):
            return scenario.suited()

    def _fit(self, spec: Spec, scenario: Scenario, plugin: Plugin | None) -> Lens | None:
        with blaming(f"scenario {scenario.type} ({plugin})"):
            try:
                return scenario.fit(spec.lens.build(), spec.viewer)
            except ValueError as error:
                self._checker.add(("scenario",), str(error))
                return None


def _writes(stage: Stage) -> str:
    """The files in a run folder that a stage calls its own."""
    suffix = getattr(stage, "suffix", "")
    return f"lens{suffix}" if stage.kind == Exporter.kind else f"renders/{stage.type}"
