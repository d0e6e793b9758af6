"""Compiles a spec into a frozen plan: every stage is chosen, every option is known, every mistake is found."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from magiclens.config.checker import Checker
from magiclens.config.document import Document, Keys, read_document
from magiclens.config.fabrication import Fabrication, find_fabrication
from magiclens.config.fields import Context, Inputs, is_outside
from magiclens.config.load import check_spec
from magiclens.config.model import DEFAULT_STAGES, FREE_FINISHER, LISTED_STAGES, Choice, PipelineSpec, Spec
from magiclens.config.suggest import advice, unknown
from magiclens.contract.artifacts import Lens, Scene
from magiclens.contract.stages import Annealer, Encoder, Exporter, Finisher, Integrator, Matcher, Renderer, Stage
from magiclens.plan.blame import blaming, locating
from magiclens.plan.registry import ANALYSIS, NAMED_ART, SCENARIO, STAGE, Plugin, Registry
from magiclens.scenarios.base import Scenario, Shot

_StageT = TypeVar("_StageT", bound=Stage)


@dataclass(frozen=True)
class Step(Generic[_StageT]):
    """One step of a plan.

    Attributes:
        stage: The stage that the spec chose, with its options.
        plugin: The plugin that contributes the stage.
    """

    stage: _StageT
    plugin: Plugin

    @property
    def name(self) -> str:
        """Kind and type, such as ``matcher exhaustive``."""
        return f"{self.stage.kind} {self.stage.type}"

    def __str__(self) -> str:
        return f"{self.name} ({self.plugin})"

    def choice(self, inputs: Inputs | None = None) -> dict[str, Any]:
        """The stage as a spec writes it, with every option.

        Args:
            inputs: Collects the files that its options name, as in ``Plan.resolved``.
        """
        with blaming(str(self)):
            return {"type": self.stage.type, **self.stage.model_dump(mode="json", context={"inputs": inputs})}


@dataclass(frozen=True)
class PlannedAnalysis:
    """An analysis that a run does.

    Attributes:
        analysis: What a plugin contributes, a ``magiclens.Analysis``.
        plugin: The plugin.
    """

    analysis: Any
    plugin: Plugin

    @property
    def name(self) -> str:
        """The name by which a spec picks it."""
        return str(self.analysis.name)

    def __str__(self) -> str:
        return f"analysis {self.name} ({self.plugin})"


@dataclass(frozen=True)
class Plan:
    """Everything a run does, in pipeline order.

    Attributes:
        spec: The spec; scenario and stages in it are as they were written.
        lens: The lens to design, with the source and the bleed that the scenario needs.
        scenario: The scenario with its options.
        scenario_plugin: The plugin that contributes the scenario.
        matcher: The stage that finds candidates.
        annealer: The stage that chooses among them.
        integrator: The stage that makes heights.
        finisher: The stage that repairs the mesh.
        encoder: The stage that paints the sources; None if they stay as they are.
        exporters: The stages that write the lens to files.
        renderers: The stages that simulate what the eye sees.
        fabrication: The machine that makes the lens, if the spec names one.
        registry: Where scenario, stages and named pictures were found.
        document: What was compiled; it knows where each option was written.
        files: The files that the spec names, each with its path as it was written.
    """

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
    document: Document = field(repr=False, compare=False)
    files: Mapping[Path, str] = field(repr=False, compare=False, default_factory=dict)

    @property
    def steps(self) -> tuple[Step[Any], ...]:
        """All stages, in pipeline order."""
        single = (self.matcher, self.annealer, self.integrator, self.finisher)
        return (*single, *([self.encoder] if self.encoder else []), *self.exporters, *self.renderers)

    @property
    def analyses(self) -> tuple[PlannedAnalysis, ...]:
        """The analyses that the spec wants and that apply to the lens, in the order in which plugins list them."""
        wanted = self.spec.report.analyses
        chosen = (self._analysis(name) for name in self.registry.classes(ANALYSIS) if wanted is None or name in wanted)
        return tuple(planned for planned in chosen if self._applies(planned))

    def _analysis(self, name: str) -> PlannedAnalysis:
        found = self.registry.find(ANALYSIS, name)  # which raises an error if several plugins claim the name
        assert found is not None
        return PlannedAnalysis(*found)

    def _applies(self, planned: PlannedAnalysis) -> bool:
        with blaming(str(planned)):
            return bool(planned.analysis.applies(self))

    @property
    def outside(self) -> dict[Path, str]:
        """Those of the files that are not in the spec's folder."""
        folder = self.document.folder
        return {path: written for path, written in self.files.items() if is_outside(path, folder)}

    def notices(self) -> tuple[str, ...]:
        """What a user ought to hear of the plan, though nothing is wrong."""
        plain = self.spec.pipeline.without_pymeshlab and self.finisher.stage.type == FREE_FINISHER
        outside = [repr(written) for written in self.outside.values()]
        return (
            *([f"pymeshlab is not installed: the finisher is {FREE_FINISHER}"] if plain else []),
            *([f"files outside of the spec's folder are read: {', '.join(outside)}"] if outside else []),
            *self._other_material(),
        )

    def _other_material(self) -> Iterator[str]:
        """A material that the machine does not usually make lenses of, which the spec writes on purpose or not."""
        written = self.spec.lens.material
        usual = self.fabrication.profile.lens.get("material") if self.fabrication else None
        if self.fabrication and usual and written and written != usual:
            yield f"lens.material is {written}, but {self.fabrication.name} usually makes lenses of {usual}"

    def place(self, step: Step[Any]) -> Keys:
        """Where in the spec a stage is, or would be if it were written: ``("pipeline", "exporters", 1)``."""
        for key in LISTED_STAGES:
            if step in getattr(self, key):
                return "pipeline", key, getattr(self, key).index(step)
        return "pipeline", str(step.stage.kind)

    def shots(self) -> tuple[Shot, ...]:
        """The views before their pictures are loaded."""
        with blaming(f"scenario {self.scenario.type} ({self.scenario_plugin})"):
            return self.scenario.shots(self.lens, self.spec.viewer)

    def scene(self) -> Scene:
        """The lens and its views with their pictures."""
        owner = f"scenario {self.scenario.type} ({self.scenario_plugin})"
        with locating(self.document, ("scenario",)), blaming(owner):
            views = self.scenario.make_views(self.lens, self.spec.viewer, self.registry.art)
            return Scene(self.lens, views, self.scenario.reserved(self.lens, self.registry.art))

    def on_medium(self, scene: Scene) -> Scene:
        """The scene as the medium of the spec, paper or a screen, shows its sources.

        Targets are mapped in the same way, since nothing that the eye sees is darker than the medium's black. Light is
        relative to the medium's white: the eye adapts to that, as the exposure does in scores. Files that are written,
        and sources that an encoder paints, keep the full range from 0 to 1: printing them does the mapping.
        """
        medium = self.spec.medium
        if medium is None:
            return scene
        # once per name, so that views which share a source still share its array
        sources = {view.source_name: medium.shown(view.source) for view in scene.views}
        views = (replace(v, source=sources[v.source_name], target=medium.shown(v.target)) for v in scene.views)
        return replace(scene, views=tuple(views))

    def resolved(self, inputs: Inputs | None = None) -> dict[str, Any]:
        """The spec with every default written out.

        Args:
            inputs: Collects the files that the spec names; their paths then are those in the run folder.
        """
        spec = self.spec.model_dump(mode="json", exclude_none=True)
        scenario = self.scenario.model_dump(mode="json", exclude_none=True, context={"inputs": inputs})
        several = {key: [step.choice(inputs) for step in getattr(self, key)] for key in LISTED_STAGES}
        single = {s.stage.kind: s.choice(inputs) for s in self.steps if s.stage.kind not in LISTED_STAGES.values()}
        rounds = {key: getattr(self.spec.pipeline, key) for key in ("rematch", "codesign")}
        making = {"fabrication": self.fabrication.resolved()} if self.fabrication else {}
        return {
            **spec,
            **making,
            "scenario": {"type": self.scenario.type, **scenario},
            "pipeline": {**single, **several, **rounds},
        }


def load_plan(
    path: str | Path, overrides: Iterable[str] = (), registry: Registry | None = None, sandbox: bool = False
) -> Plan:
    """Read a spec and compile it.

    Args:
        path: The spec, a YAML file.
        overrides: Values to change, as text ``key.path=value``, such as ``lens.facets=64``.
        registry: Where stages are looked up; by default everything that is installed.
        sandbox: Whether files outside of the spec's folder are mistakes.

    Raises:
        InputError: The spec has a mistake. The message names the first one in the order of the file.
        StageError: Two packages contribute a stage that the spec chooses.
    """
    return compile_plan(read_document(path, overrides), registry or Registry.load(), sandbox)


def compile_plan(document: Document, registry: Registry, sandbox: bool = False) -> Plan:
    """Compile a spec that has been read already. Raises like ``load_plan``."""
    return _Compiler(document, registry, sandbox).plan()


class _Compiler:
    """Compiles every part of one document, even if others have mistakes, so that the first mistake can be named."""

    def __init__(self, document: Document, registry: Registry, sandbox: bool):
        self._document, self._registry, self._files = document, registry, dict[Path, str]()
        context = Context(folder=document.folder, art=registry.types(NAMED_ART), sandbox=sandbox, files=self._files)
        self._checker = Checker(document, context)
        self._fabrication = find_fabrication(document, self._checker)

    def plan(self) -> Plan:
        """The plan, or the first mistake."""
        scenario, scenario_plugin = self._scenario()
        suited, usual = self._suited(scenario, scenario_plugin)
        spec = check_spec(self._document, self._checker, self._fabrication, usual)
        if spec and scenario and "rematch" not in spec.pipeline.model_fields_set:
            pipeline = spec.pipeline.model_copy(update={"rematch": scenario.suitable_rematch})
            spec = spec.model_copy(update={"pipeline": pipeline})
        # where both choose a stage, the scenario's choice wins: without it the lens shows nothing
        if self._fabrication and spec:
            suited = self._fabrication.suited(suited, spec.lens)
        steps = self._steps(suited)
        lens = self._fit(spec, scenario, scenario_plugin) if spec and scenario else None
        self._check_analyses(spec)
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
            document=self._document,
            files=self._files,
        )

    def _scenario(self) -> tuple[Scenario, Plugin] | tuple[None, None]:
        written = self._document.data.get("scenario")
        if not isinstance(written, dict):
            return None, None  # a mistake of the spec, which is noted with its other keys
        found = self._pick(("scenario",), written, SCENARIO)
        return (self._options(found, written, ("scenario",), "key"), found[1]) if found else (None, None)

    def _steps(self, suited: Mapping[str, Choice]) -> dict[str, list[Step[Any] | None]]:
        """The stages at each key of the pipeline; None in place of those that have mistakes."""
        pipeline = self._checker.validate(PipelineSpec, self._document.data.get("pipeline", {}), ("pipeline",))
        # the mistakes are noted, and ``settle`` raises the first of them before a plan is made
        if pipeline is None:
            return defaultdict(lambda: [None])
        if self._fabrication and "exporters" not in pipeline.model_fields_set:
            pipeline = pipeline.model_copy(update={"exporters": self._fabrication.profile.exporters})
        choices = {kind: pipeline.choice(kind, suited) for kind in (*DEFAULT_STAGES, Encoder.kind)}
        single = {k: [self._step(k, choice, ("pipeline", k))] if choice else [] for k, choice in choices.items()}
        several = {key: self._list(key, getattr(pipeline, key)) for key in LISTED_STAGES}
        return {**single, **several}

    def _check_analyses(self, spec: Spec | None) -> None:
        """Note names of analyses that no plugin contributes; ``find`` raises an error where several do."""
        wanted = spec.report.analyses if spec else []
        for i, name in enumerate(self._registry.classes(ANALYSIS) if wanted is None else wanted):
            if self._registry.find(ANALYSIS, name) is None:
                self._checker.add(("report", "analyses", i), self._unknown(name, ANALYSIS))

    def _list(self, key: str, choices: list[Choice]) -> list[Step[Any] | None]:
        """The stages of a list; no two of them may write the same files."""
        steps = [self._step(LISTED_STAGES[key], choice, ("pipeline", key, i)) for i, choice in enumerate(choices)]
        files = [_written_file(step.stage) if step else None for step in steps]
        for i, file in enumerate(files):
            if file and file in files[:i]:
                self._checker.add(("pipeline", key, i), f"an earlier one writes {file} already; keep one of them")
        return steps

    def _step(self, kind: str, choice: Choice, at: Keys) -> Step[Any] | None:
        found = self._pick(at, choice, STAGE, kind)
        # what the spec writes is laid over what the machine needs
        usual = self._options_of_machine(found[0]) if found and kind == Exporter.kind else {}
        stage = self._options(found, {**usual, **choice}, at, "option") if found else None
        return Step(stage, found[1]) if found and stage else None

    def _options_of_machine(self, exporter: type[Exporter]) -> Choice:
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

    def _suited(self, scenario: Scenario | None, plugin: Plugin | None) -> tuple[dict[str, Choice], dict[str, Any]]:
        """Stages that suit the scenario, by kind, and keys of the lens."""
        if scenario is None:
            return {}, {}
        with blaming(f"scenario {scenario.type} ({plugin})"):
            return scenario.suitable_stages(), scenario.suitable_lens()

    def _fit(self, spec: Spec, scenario: Scenario, plugin: Plugin | None) -> Lens | None:
        with blaming(f"scenario {scenario.type} ({plugin})"):
            try:
                lens, glass = spec.lens.build(), spec.medium.gap_mm if spec.medium else 0.0
                lens = scenario.fitted_lens(replace(lens, gap_mm=lens.gap_mm + glass), spec.viewer)
                making = self._fabrication
                rim_mm = making.machine.rim_mm(lens, spec.viewer.distance) if making else 0.0
                return replace(lens, bleed_mm=max(lens.bleed_mm, rim_mm))
            # caught inside ``blaming``: it is a mistake of the spec, not of the plugin
            except ValueError as error:
                self._checker.add(("scenario",), str(error))
                return None


def _written_file(stage: Stage) -> str:
    """The file or folder in a run folder that only this stage may write."""
    suffix = getattr(stage, "suffix", "")
    return f"lens{suffix}" if stage.kind == Exporter.kind else f"renders/{stage.type}"
