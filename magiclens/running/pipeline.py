"""The only loop: calls the stages of a plan one after the other and records what they did."""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from magiclens.config.document import document_of
from magiclens.config.fields import Inputs
from magiclens.config.model import Spec
from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid, Transport
from magiclens.contract.checks import (
    BadArtifact,
    check_assignment,
    check_candidates,
    check_encoded,
    check_file,
    check_height_field,
    check_pictures,
    check_solid,
)
from magiclens.contract.errors import InputError
from magiclens.contract.result import RunResult, Zone
from magiclens.contract.stages import KINDS, Exporter, Progress, Renderer
from magiclens.plan.blame import Blamed, blaming
from magiclens.plan.compile import Plan, Step, compile_plan, load_plan
from magiclens.plan.registry import Registry
from magiclens.profiles.machines import Machine
from magiclens.running.folder import atomic_folder, save_heights, save_transport
from magiclens.running.manifest import (
    ScoresByRenderer,
    build_manifest,
    render_path,
    spec_text,
    target_path,
    write_manifest,
)
from magiclens.running.observers import Observer

T = TypeVar("T")
Renders = dict[str, list[FloatArray]]
Generators = dict[str, np.random.Generator]


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run: its folder, the manifest in it, and everything that was made on the way."""

    folder: Path
    manifest: dict[str, Any]
    data: RunResult

    @property
    def sources(self) -> dict[str, FloatArray]:
        """(H, W, C) float32, linear light, by name: what lies below the lens, on its paper or screen."""
        return {view.source_name: view.source for view in self.data.scene.views}

    @property
    def targets(self) -> dict[str, FloatArray]:
        """(H, W, C) float32, linear light, by view: what the eye shall see."""
        return {view.name: view.target for view in self.data.scene.views}

    @property
    def renders(self) -> dict[str, dict[str, FloatArray]]:
        """(R, R, C) float32, linear light, by renderer and view: what the eye sees."""
        names = [view.name for view in self.data.scene.views]
        return {name: dict(zip(names, pictures, strict=True)) for name, pictures in self.data.renders.items()}

    @property
    def heights(self) -> FloatArray:
        """(N, N, m + 1, m + 1) float64, mm: the lens's top, see ``HeightField``."""
        return self.data.height_field.heights_mm

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

        return contact_html(self.data)


def run(
    spec: str | Path | Mapping[str, Any] | Spec,
    out_dir: str | Path | None = None,
    overrides: Iterable[str] = (),
    observer: Observer | None = None,
) -> Run:
    """Run a spec: a file, a mapping as its YAML would say it, or a ``Spec``; files named in the latter two start here.

    The run folder is ``out/<name>`` unless told otherwise. Raises like ``run_plan``.
    """
    if isinstance(spec, str | Path):
        return run_spec(spec, out_dir, overrides, observer)
    data = spec.model_dump(mode="json", exclude_none=True) if isinstance(spec, Spec) else spec
    plan = compile_plan(document_of(data, overrides), Registry.load())
    return run_plan(plan, out_dir or Path("out", plan.spec.name), observer)


def run_spec(
    path: str | Path, out_dir: str | Path | None = None, overrides: Iterable[str] = (), observer: Observer | None = None
) -> Run:
    """Load, compile and run a spec; the run folder is ``out/<name>`` unless told otherwise."""
    plan = load_plan(path, overrides)
    return run_plan(plan, out_dir or Path("out", plan.spec.name), observer)


def run_plan(plan: Plan, out_dir: str | Path, observer: Observer | None = None) -> Run:
    """Run a plan and write its run folder, which appears only when everything in it is finished.

    Equal plans give equal files, but for the timings in ``manifest.json``. Raises InputError when the spec asks for
    what cannot be, StageError when a stage fails or breaks its contract.
    """
    out, observer = Path(out_dir), observer or Observer()
    worker = _Worker(plan, observer)
    for failure in plan.registry.failures:
        observer.notice(f"{failure}; see 'mlens plugins'")
    try:
        with atomic_folder(out) as folder:
            data = _make(plan, folder, worker)
            whole = write_manifest(folder, data.manifest, worker.timings())
        worker.tell("mlens_run_done", folder=out, manifest=whole)
    finally:
        observer.stopped()
    return Run(out, whole, data)


class _Worker:
    """Does one piece of work after the other: times it, lets the observer know, and names the stage that fails."""

    def __init__(self, plan: Plan, observer: Observer):
        self._registry, self._observer = plan.registry, observer
        self._facets = plan.lens.facets**2
        self._began = perf_counter()
        self._seconds: defaultdict[str, float] = defaultdict(float)

    def part(self, name: str, work: Callable[[], T], facets: int = 0) -> T:
        """A piece of work of our own."""
        self._observer.started(name, facets)
        began = perf_counter()
        result = work()
        seconds = perf_counter() - began
        self._seconds[name] += seconds
        self._observer.finished(name, seconds)
        return result

    def stage(self, step: Step[Any], work: Callable[[Progress], T], check: Callable[[T], None]) -> T:
        """A piece of work of a stage, whose artifact is checked against the contract."""
        before = self._seconds[step.name]
        artifact = self.part(step.name, partial(self._guarded, step, work, check), self._facets)
        seconds = self._seconds[step.name] - before
        self.tell("mlens_stage_done", stage=step.stage, artifact=artifact, seconds=seconds)
        return artifact

    def tell(self, hook: str, **facts: Any) -> None:
        """Call an observing hook; plugins that fail in it are noted."""
        for complaint in self._registry.notify(hook, **facts):
            self._observer.notice(complaint)

    def timings(self) -> dict[str, float]:
        """Seconds by name, and in total."""
        return {**self._seconds, "total": perf_counter() - self._began}

    def _guarded(self, step: Step[Any], work: Callable[[Progress], T], check: Callable[[T], None]) -> T:
        with blaming(str(step)):
            artifact = work(partial(self._observer.progressed, step.name))
            try:
                check(artifact)
            except BadArtifact as error:
                raise Blamed(f"{step} broke its contract: {error}") from error
            return artifact


class _Aside(_Worker):
    """Works on what is not the run's lens, so nobody is told."""

    def tell(self, hook: str, **facts: Any) -> None:
        """Nothing."""


def _make(plan: Plan, folder: Path, worker: _Worker) -> RunResult:
    """Fill a run folder with everything but the manifest."""
    from magiclens.report.write import write_report

    inputs = Inputs()
    (folder / "spec.yaml").write_text(spec_text(plan, inputs), encoding="utf-8")
    _copy(inputs, folder)
    given = scene = worker.part("pictures", plan.scene)
    rng = _generators(plan.spec.seed)
    for _ in range(plan.spec.pipeline.codesign):
        *_, solid = _design(plan, plan.on_medium(scene), rng, worker)
        scene = _encode(plan, given, _matrices(plan, given, solid, worker), rng, worker)
    candidates, assignment, height_field, rough = _design(plan, plan.on_medium(scene), rng, worker)
    solid = worker.stage(plan.finisher, lambda p: plan.finisher.stage.finish(given, rough, p), check_solid)
    matrices = _matrices(plan, given, solid, worker)
    scene = _encode(plan, given, matrices, rng, worker)
    _write_pictures(scene, folder)
    save_heights(solid, plan.lens, folder)
    if matrices:
        worker.part("matrices", partial(_save_transports, given, matrices, folder))
    for exporter in plan.exporters:
        _export(exporter, scene, solid, folder, worker)
    shown = plan.on_medium(scene)
    renders = {step.stage.type: _render(step, shown, solid, folder, worker) for step in plan.renderers}
    if plan.scenario.frames_per_second and renders:
        animate = partial(_animate, scene, plan.scenario.frames_per_second, next(iter(renders.values())), folder)
        worker.part("animations", animate)
    made = (candidates, assignment, height_field, rough, solid)
    first = Assignment.pick(candidates, candidates.errors.argmin(axis=-1))
    metrics = worker.part("bounds", partial(_bounds, shown, candidates, first, assignment, height_field))
    metrics |= {name: value for artifact in made for name, value in artifact.metrics.items()}
    zone = _zone(plan, given, scene, rough, worker)
    if zone:
        metrics |= zone.metrics
    hidden = matched = None
    if plan.encoder:
        from magiclens.analysis.leaks import leaks
        from magiclens.analysis.secrecy import secrecy

        hidden = worker.part("secrecy", partial(secrecy, scene, assignment))
        metrics |= worker.part("leaks", partial(leaks, matrices, plan.lens.facets, given.reserved))
        metrics |= _changes(given, scene) | hidden.metrics
        _write_sources(given, folder, "given")
    matched = None if plan.matcher.stage.uses_pictures else worker.part("matched lens", partial(_matched, scene))
    if plan.fabrication:
        metrics |= worker.part("as made", partial(_as_made, plan.fabrication.machine, shown, solid, folder))
    facts = build_manifest(plan, inputs, scene, metrics, _scores(shown, renders))
    worker.part("preflight", partial(_preflight, plan, facts, solid, folder))
    asked = shown if given is scene else plan.on_medium(given)
    data = RunResult(
        asked, shown, candidates, first, assignment, height_field, solid, renders, facts, zone, hidden, matched
    )
    worker.part("report", partial(write_report, data, folder))
    return data


def _design(
    plan: Plan, scene: Scene, rng: Generators, worker: _Worker
) -> tuple[Candidates, Assignment, HeightField, Solid]:
    """From a scene to a closed mesh that no finisher has seen yet."""
    from magiclens.geometry.solid import solid_from_heights

    matcher = plan.matcher.stage
    scene = scene if matcher.uses_pictures else _blank(scene)
    check = partial(check_candidates, plan.lens)
    candidates = worker.stage(plan.matcher, lambda p: matcher.match(scene, rng["matcher"], p), check)
    best = (candidates, *_shape(plan, scene, candidates, rng["annealer"], worker))
    if plan.spec.pipeline.rematch:
        best = _rematched(plan, scene, best, rng, worker)
    candidates, assignment, built = best
    if matcher.uses_pictures:
        refined, integrator = partial(plan.integrator.stage.refine, scene, built), plan.integrator
        built = worker.stage(integrator, refined, partial(check_height_field, plan.lens))
    return candidates, assignment, built, worker.part("meshing", partial(solid_from_heights, built))


def _blank(scene: Scene) -> Scene:
    """The scene without its pictures, so that the lens does not depend on them: whatever light is lost counts."""
    white, black = np.ones((1, 1, 1), np.float32), np.zeros((1, 1, 1), np.float32)
    return replace(scene, views=tuple(replace(view, source=white, target=black) for view in scene.views))


def _rematched(
    plan: Plan, scene: Scene, best: tuple[Candidates, Assignment, HeightField], rng: Generators, worker: _Worker
) -> tuple[Candidates, Assignment, HeightField]:
    """Rounds of rematching, annealing and integration until the traced error stops falling (4.6, last paragraph)."""
    from magiclens.rendering.facet_errors import facet_errors

    check = partial(check_candidates, plan.lens)
    errors = worker.part("tracing", partial(facet_errors, scene, best[2]))
    for _ in range(plan.spec.pipeline.rematch):
        again = partial(plan.matcher.stage.rematch, scene, *best, errors)
        candidates = worker.stage(plan.matcher, again, check)
        trial = (candidates, *_shape(plan, scene, candidates, rng["annealer"], worker))
        errors_now = worker.part("tracing", partial(facet_errors, scene, trial[2]))
        if errors_now.mean() >= errors.mean():
            break
        best, errors = trial, errors_now
    return best


def _matrices(plan: Plan, given: Scene, solid: Solid, worker: _Worker) -> list[Transport]:
    """What an encoder needs to know of a solid; nothing if there is no encoder."""
    if plan.encoder is None:
        return []
    from magiclens.rendering.transports import transports

    return worker.part("tracing", partial(transports, given, solid))


def _encode(plan: Plan, given: Scene, matrices: list[Transport], rng: Generators, worker: _Worker) -> Scene:
    """The scene with its sources edited for a traced solid, always starting from those that were given."""
    if plan.encoder is None:
        return given
    step, encoder = plan.encoder, plan.encoder.stage
    check = partial(check_encoded, given)
    encoded: Scene = worker.stage(step, lambda p: encoder.encode(given, matrices, rng["encoder"], p), check)
    return encoded


def _changes(given: Scene, scene: Scene) -> dict[str, float]:
    """How much the sources still look like those that were given, on average over the sources."""
    from magiclens.images.score import score

    both = zip(given.views, scene.views, strict=True)
    pairs = {new.source_name: score(new.source, old.source, 1.0) for old, new in both}
    scores = list(pairs.values())
    return {
        "source_psnr_db": float(np.mean([s.psnr_db for s in scores])),
        "source_ssim": float(np.mean([s.ssim for s in scores])),
    }


def _bounds(
    scene: Scene, candidates: Candidates, first: Assignment, assignment: Assignment, built: HeightField
) -> dict[str, float]:
    """PSNR if every facet realised its best candidate, or its assigned one, exactly."""
    from magiclens.analysis.ideal import bound_psnr_db

    return {
        "matching_psnr_db": bound_psnr_db(scene, first, candidates.heights_mm),
        "assigned_psnr_db": bound_psnr_db(scene, assignment, built.levels_mm),
    }


def _zone(plan: Plan, given: Scene, scene: Scene, solid: Solid, worker: _Worker) -> Zone | None:
    """If all eyes shall see the same: what they see in between, beside a lens that was made for the first eye alone."""
    from magiclens.analysis.zone import measure, rings

    if not rings(given):
        return None
    rng, aside, first = _generators(plan.spec.seed), _Aside(plan, Observer()), replace(given, views=given.views[:1])
    design = partial(_design, plan, plan.on_medium(first), rng, aside)
    *_, plain = worker.part("plain lens", design, plan.lens.facets**2)
    plain_scene = _encode(plan, first, _matrices(plan, first, plain, aside), rng, aside)
    seen = partial(measure, plan.on_medium(scene), solid, plan.on_medium(plain_scene), plain)
    return worker.part("stable zone", seen)


def _shape(
    plan: Plan, scene: Scene, candidates: Candidates, rng: np.random.Generator, worker: _Worker
) -> tuple[Assignment, HeightField]:
    """Choose among candidates and build what was chosen."""
    annealer, integrator = plan.annealer.stage, plan.integrator.stage
    chosen = partial(check_assignment, plan.lens, candidates)
    assignment = worker.stage(plan.annealer, lambda p: annealer.anneal(scene, candidates, rng, p), chosen)
    built = partial(check_height_field, plan.lens)
    return assignment, worker.stage(plan.integrator, lambda p: integrator.integrate(scene, assignment, p), built)


def _generators(seed: int) -> Generators:
    """One source of randomness per kind of stage, so that a change of one leaves the others' alone."""
    children = np.random.SeedSequence(seed).spawn(len(KINDS))
    return {kind: np.random.default_rng(child) for kind, child in zip(KINDS, children, strict=True)}


def _copy(inputs: Inputs, folder: Path) -> None:
    """Keep the files that the spec uses, so that the run folder's ``spec.yaml`` runs anywhere."""
    for path, kept in inputs.items():
        (folder / kept).parent.mkdir(exist_ok=True)
        shutil.copyfile(path, folder / kept)


def _write_pictures(scene: Scene, folder: Path) -> None:
    """The sources, true to scale for printing, and the targets."""
    from magiclens.images.files import write_png

    _write_sources(scene, folder)
    (folder / "targets").mkdir()
    for path, picture in {target_path(view): view.target for view in scene.views}.items():
        write_png(folder / path, picture)


def _write_sources(scene: Scene, folder: Path, kept: str = "sources") -> None:
    """Every source once, with its physical size."""
    from magiclens.images.files import write_png

    (folder / kept).mkdir()
    for name, picture in {view.source_name: view.source for view in scene.views}.items():
        write_png(folder / kept / f"{name}.png", picture, len(picture) / scene.lens.source_size_mm)


def _save_transports(scene: Scene, matrices: list[Transport], folder: Path) -> None:
    """Keep those of the views that the others are like."""
    from magiclens.rendering.transports import traced_view

    for view, matrix in zip(scene.views, matrices, strict=True):
        if traced_view(scene, view) is view:
            save_transport(matrix, view, folder)


def _export(step: Step[Exporter], scene: Scene, solid: Solid, folder: Path, worker: _Worker) -> None:
    path = folder / f"lens{step.stage.suffix}"

    def export(_: Progress) -> Path:
        step.stage.export(scene, solid, path)
        return path

    worker.stage(step, export, check_file)


def _render(step: Step[Renderer], scene: Scene, solid: Solid, folder: Path, worker: _Worker) -> list[FloatArray]:
    """One picture per view, written to the run folder too."""
    from magiclens.images.files import write_png

    check = partial(check_pictures, scene)
    pictures: list[FloatArray] = worker.stage(step, lambda p: step.stage.render(scene, solid, p), check)
    for view, picture in zip(scene.views, pictures, strict=True):
        path = folder / render_path(step.stage.type, view)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, picture)
    return pictures


def _animate(scene: Scene, fps: float, seen: list[FloatArray], folder: Path) -> None:
    """The sources in turn, and what the eye sees meanwhile, as GIF and MP4."""
    from magiclens.images import resize
    from magiclens.images.movies import write_gif, write_mp4

    (folder / "animations").mkdir()
    side = len(seen[0])
    for name, frames in (("sources", [resize(view.source, (side, side)) for view in scene.views]), ("seen", seen)):
        write_gif(folder / "animations" / f"{name}.gif", frames, fps)
        write_mp4(folder / "animations" / f"{name}.mp4", frames, fps)


def _matched(scene: Scene) -> Assignment | None:
    """Every facet at its best patch of the first source as it is now; None if some facet reaches no patch."""
    from magiclens.matching.exhaustive import Exhaustive

    try:
        found = Exhaustive().match(replace(scene, views=scene.views[:1]), np.random.default_rng(0))
    except InputError:
        return None
    return Assignment.pick(found, found.errors.argmin(axis=-1))


def _as_made(machine: Machine, scene: Scene, solid: Solid, folder: Path) -> dict[str, float]:
    """What the lens shows as the machine makes it, as pictures, and what that costs; nothing if it is not simulated."""
    from magiclens.simulation.as_made import as_made, write_pictures

    made = as_made(machine, scene, solid)
    if made is None:
        return {}
    write_pictures(made.pictures, scene.views, folder, "as-made")
    return {"as_made_psnr_db": made.psnr_db, "fabrication_loss_db": made.loss_db}


def _preflight(plan: Plan, facts: dict[str, Any], solid: Solid, folder: Path) -> None:
    """Check what was exported, if it is a mesh."""
    from magiclens.preflight.exported import mesh_files

    if mesh_files(folder):
        from magiclens.preflight.inspect import inspect
        from magiclens.preflight.page import write_preflight

        write_preflight(inspect(folder, facts, plan, solid), folder)


def _scores(scene: Scene, renders: Renders) -> ScoresByRenderer:
    from magiclens.images.score import score

    return {
        renderer: [score(picture, view.target) for picture, view in zip(pictures, scene.views, strict=True)]
        for renderer, pictures in renders.items()
    }
