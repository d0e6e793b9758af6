"""Runs a plan: calls its stages one after the other, analyses the lens, and writes the run folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from magiclens.analysis.base import Findings
from magiclens.config.document import document_of
from magiclens.config.fields import Inputs
from magiclens.config.model import Spec
from magiclens.contract.artifacts import FloatArray, Scene, Solid
from magiclens.contract.checks import BadArtifact, check_file, check_pictures, check_solid
from magiclens.contract.result import RunResult
from magiclens.contract.stages import Exporter, Progress
from magiclens.drawing.figure import Figure
from magiclens.plan.blame import blaming
from magiclens.plan.compile import Plan, PlannedAnalysis, Step, compile_plan, load_plan
from magiclens.plan.registry import Registry
from magiclens.running.design import Designer
from magiclens.running.folder import place_for, save_heights
from magiclens.running.manifest import ScoresByRenderer, build_manifest, spec_text, write_manifest
from magiclens.running.observers import Observer
from magiclens.running.replacing import atomic_folder
from magiclens.running.steps import QuietSteps, Steps
from magiclens.running.writing import (
    copy_inputs,
    save_transports,
    write_animations,
    write_figure_pictures,
    write_renders,
    write_scene_pictures,
    write_sources,
)

Renders = dict[str, list[FloatArray]]
"""One picture (R, R, C) per view, linear light, by renderer type."""
Analysed = list[tuple[PlannedAnalysis, Findings]]
"""Analyses that have found something, each with its findings."""


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run.

    Attributes:
        folder: Its run folder.
        manifest: What ``manifest.json`` in it holds.
        result: Everything that was made on the way.
    """

    folder: Path
    manifest: dict[str, Any]
    result: RunResult

    @property
    def sources(self) -> dict[str, FloatArray]:
        """(H, W, C) float32, linear light, by name: what lies below the lens, on its paper or screen."""
        return {view.source_name: view.source for view in self.result.scene.views}

    @property
    def targets(self) -> dict[str, FloatArray]:
        """(H, W, C) float32, linear light, by view: what the eye shall see."""
        return {view.name: view.target for view in self.result.scene.views}

    @property
    def renders(self) -> dict[str, dict[str, FloatArray]]:
        """(R, R, C) float32, linear light, by renderer and view: what the eye sees."""
        names = [view.name for view in self.result.scene.views]
        return {name: dict(zip(names, pictures, strict=True)) for name, pictures in self.result.renders.items()}

    @property
    def heights(self) -> FloatArray:
        """(N, N, m + 1, m + 1) float64, mm: the lens's top, see ``HeightField``."""
        return self.result.height_field.heights_mm

    @property
    def scores(self) -> dict[str, dict[str, float | None]]:
        """By view: ``psnr_db`` and ``ssim`` of each renderer, as the manifest has them."""
        views = self.manifest["views"]
        return {v["name"]: {k: x for k, x in v.items() if k.startswith(("psnr_db", "ssim"))} for v in views}

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: {self.manifest['scenario']}, {', '.join(self.scores)})"

    def _repr_html_(self) -> str:
        """The contact sheet, for notebooks."""
        from magiclens.report.inline import contact_html

        return contact_html(self.result)


def run(
    spec: str | Path | Mapping[str, Any] | Spec,
    out_dir: str | Path | None = None,
    overrides: Iterable[str] = (),
    observer: Observer | None = None,
) -> Run:
    """Run a spec from Python.

    Args:
        spec: A YAML file, a mapping as its YAML would say it, or a ``Spec``. Paths in the latter two start at the
            working directory.
        out_dir: The run folder; ``out/<name>`` by default.
        overrides: ``key.path=value`` texts that are laid over the spec, as ``--set`` does.
        observer: Is told about progress; None prints notices only.

    Raises:
        InputError: The spec is wrong, or asks for what cannot be.
        StageError: A stage failed or broke its contract.
    """
    if isinstance(spec, str | Path):
        return run_spec(spec, out_dir, overrides, observer)
    data = spec.model_dump(mode="json", exclude_none=True) if isinstance(spec, Spec) else spec
    plan = compile_plan(document_of(data, overrides), Registry.load())
    return run_plan(plan, out_dir or Path("out", plan.spec.name), observer)


def run_spec(
    path: str | Path, out_dir: str | Path | None = None, overrides: Iterable[str] = (), observer: Observer | None = None
) -> Run:
    """Load, compile and run a spec file; arguments and errors are those of ``run``."""
    plan = load_plan(path, overrides)
    return run_plan(plan, out_dir or Path("out", plan.spec.name), observer)


def run_plan(plan: Plan, out_dir: str | Path, observer: Observer | None = None) -> Run:
    """Run a plan and write its run folder, which appears only when everything in it is finished.

    Equal plans give equal files, but for the timings in ``manifest.json``. An older run at ``out_dir`` is replaced.

    Raises:
        InputError: The spec asks for what cannot be, or something at ``out_dir`` would be lost, see ``place_for``.
        StageError: A stage failed or broke its contract.
    """
    out, observer = Path(out_dir), observer or Observer()
    place = place_for(out)
    steps = Steps(plan, observer)
    for failure in plan.registry.failures:
        observer.notice(f"{failure}; see 'mlens plugins'")
    try:
        with atomic_folder(place, observer.notice) as folder:
            result = _make(plan, folder, steps)
            whole = write_manifest(folder, result.manifest, steps.timings())
        # only now, when the folder is in its place: observers may read it
        steps.tell("mlens_run_done", folder=out, manifest=whole)
    finally:
        observer.stopped()
    return Run(out, whole, result)


def _make(plan: Plan, folder: Path, steps: Steps) -> RunResult:
    """Fill a run folder with everything but the manifest."""
    from magiclens.report.write import write_report

    inputs = Inputs()
    (folder / "spec.yaml").write_text(spec_text(plan, inputs), encoding="utf-8")
    copy_inputs(inputs, folder)
    given = steps.part("pictures", plan.scene)
    result = _show(plan, _design(plan, given, steps), folder, steps)
    answers = _analyse(plan, result, folder, steps)
    metrics = _metrics(result, answers)
    facts = build_manifest(plan, inputs, result.painted, metrics, _scores(result.scene, result.renders))
    result = replace(result, manifest=facts)
    steps.part("preflight", partial(_preflight, plan, facts, result.solid, folder))
    figures = [figure for planned, findings in answers for figure in _drawn(planned, result, findings)]
    steps.part("report", partial(write_report, result, figures, folder))
    return result


def _design(plan: Plan, given: Scene, steps: Steps) -> RunResult:
    """The lens and, if there is an encoder, its painted sources."""
    designer, painted = Designer(plan, steps), given
    # while lens and sources change in turns the mesh need not be finished: only the last one is exported
    for _ in range(plan.spec.pipeline.codesign):
        _, solid = designer.design(plan.on_medium(painted))
        painted = designer.encode(given, designer.transports(given, solid))
    shape, unfinished = designer.design(plan.on_medium(painted))
    solid = steps.stage(plan.finisher, partial(plan.finisher.stage.finish, given, unfinished), check_solid)
    transports = designer.transports(given, solid)
    painted = designer.encode(given, transports)
    return RunResult(
        given=given,
        painted=painted,
        scene=plan.on_medium(painted),
        candidates=shape.candidates,
        assignment=shape.assignment,
        height_field=shape.height_field,
        unfinished=unfinished,
        solid=solid,
        renders={},
        transports=transports,
        redesign=partial(_redesign, plan),
    )


def _redesign(plan: Plan, given: Scene) -> tuple[Scene, Solid]:
    """Design another scene by the same plan and seed, without hooks and progress; see ``RunResult.redesign``."""
    designer = Designer(plan, QuietSteps(plan, Observer()))
    _, solid = designer.design(plan.on_medium(given))
    return plan.on_medium(designer.encode(given, designer.transports(given, solid))), solid


def _show(plan: Plan, result: RunResult, folder: Path, steps: Steps) -> RunResult:
    """Write the pictures and the lens, then render it; the result with its renders."""
    write_scene_pictures(result.painted, folder)
    if plan.encoder:
        write_sources(result.given, folder, "given")
    save_heights(result.solid, plan.lens, folder)
    if result.transports:
        steps.part("matrices", partial(save_transports, result.given, result.transports, folder))
    for exporter in plan.exporters:
        _export(exporter, result.painted, result.solid, folder, steps)
    renders: Renders = {}
    for renderer in plan.renderers:
        render = partial(renderer.stage.render, result.scene, result.solid)
        pictures = steps.stage(renderer, render, partial(check_pictures, result.scene))
        write_renders(renderer.stage.type, result.scene, pictures, folder)
        renders[renderer.stage.type] = pictures
    if plan.scenario.frames_per_second and renders:
        seen = next(iter(renders.values()))
        animate = partial(write_animations, result.painted, plan.scenario.frames_per_second, seen, folder)
        steps.part("animations", animate)
    return replace(result, renders=renders)


def _export(step: Step[Exporter], scene: Scene, solid: Solid, folder: Path, steps: Steps) -> None:
    path = folder / f"lens{step.stage.suffix}"

    def export(_: Progress) -> Path:
        step.stage.export(scene, solid, path)
        return path

    steps.stage(step, export, check_file)


def _analyse(plan: Plan, result: RunResult, folder: Path, steps: Steps) -> Analysed:
    """What the analyses of the plan find, in their order; pictures that they find are written."""
    answers = []
    for planned in plan.analyses:
        findings = steps.part(planned.name, partial(_findings, plan, planned, result))
        if findings:
            write_figure_pictures(findings.pictures, folder)
            answers.append((planned, findings))
    return answers


def _findings(plan: Plan, planned: PlannedAnalysis, result: RunResult) -> Findings | None:
    with blaming(str(planned)):
        findings = planned.analysis.compute(plan, result)
        if findings is not None and not isinstance(findings, Findings):
            raise BadArtifact(f"it found a {type(findings).__name__} instead of Findings")
        return findings


def _drawn(planned: PlannedAnalysis, result: RunResult, findings: Findings) -> list[Figure]:
    with blaming(str(planned)):
        return list(planned.analysis.figures(result, findings))


def _metrics(result: RunResult, answers: Analysed) -> dict[str, float]:
    """Numbers for the manifest, from artifacts and analyses."""
    made = (result.candidates, result.assignment, result.height_field, result.unfinished, result.solid)
    sources = [*(artifact.metrics for artifact in made), *(findings.metrics for _, findings in answers)]
    return {name: value for metrics in sources for name, value in metrics.items()}


def _preflight(plan: Plan, facts: dict[str, Any], solid: Solid, folder: Path) -> None:
    """Check what was exported, if it is a mesh."""
    from magiclens.preflight.mesh_file import mesh_files

    if mesh_files(folder):
        from magiclens.preflight.checks import run_preflight
        from magiclens.preflight.page import write_preflight

        write_preflight(run_preflight(folder, facts, plan, solid), folder)


def _scores(scene: Scene, renders: Mapping[str, Sequence[FloatArray]]) -> ScoresByRenderer:
    from magiclens.images.score import score

    return {
        renderer: [score(picture, view.target) for picture, view in zip(pictures, scene.views, strict=True)]
        for renderer, pictures in renders.items()
    }
