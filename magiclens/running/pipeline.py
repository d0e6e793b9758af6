"""Runs a plan: calls its stages one after the other, analyses the lens, and writes the run folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from magiclens.cache.store import Cache, new_entry, usual_cache
from magiclens.config.document import document_of
from magiclens.config.fields import Inputs
from magiclens.config.model import LISTED_STAGES, Spec
from magiclens.contract.artifacts import FloatArray
from magiclens.contract.result import RunResult
from magiclens.contract.stages import Stage
from magiclens.plan.compile import Plan, compile_plan, load_plan
from magiclens.plan.registry import Registry
from magiclens.running.answers import Questions
from magiclens.running.feasible import require_feasible
from magiclens.running.folder import place_for
from magiclens.running.ingredients import key_of, of_run
from magiclens.running.making import export_lens, make_lens
from magiclens.running.manifest import build_manifest, outside_inputs, spec_text, write_manifest
from magiclens.running.observers import Observer
from magiclens.running.replacing import atomic_folder
from magiclens.running.steps import Steps
from magiclens.running.writing import copy_inputs

_T = TypeVar("_T")


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
    stages: Iterable[Stage] = (),
) -> Run:
    """Run a spec from Python.

    Args:
        spec: A YAML file, a mapping as its YAML would say it, or a ``Spec``. Paths in the latter two start at the
            working directory.
        out_dir: The run folder; ``out/<name>`` by default.
        overrides: ``key.path=value`` texts that are laid over the spec, as ``--set`` does.
        observer: Is told about progress; None prints notices only.
        stages: Such as ``[MyAnnealer(rounds=5)]``: they take the place of the spec's stages of their kinds. Their
            classes need no plugin; a run folder whose stages come from none cannot be opened again.

    Raises:
        InputError: The spec is wrong, or asks for what cannot be.
        StageError: A stage failed or broke its contract.
    """
    given, registry = list(stages), Registry.load()
    registry.lend(map(type, given))
    wished = [*overrides, *_choosing(given)]
    if isinstance(spec, str | Path):
        plan = load_plan(spec, wished, registry)
    else:
        data = spec.model_dump(mode="json", exclude_none=True) if isinstance(spec, Spec) else spec
        plan = compile_plan(document_of(data, wished), registry)
    return run_plan(plan, out_dir or Path("out", plan.spec.name), observer)


def _choosing(stages: Sequence[Stage]) -> Iterator[str]:
    """The texts by which ``--set`` would choose these stages."""
    lists = {kind: key for key, kind in LISTED_STAGES.items()}
    for kind in dict.fromkeys(stage.kind for stage in stages):
        choices = [{"type": s.type, **s.model_dump(mode="json")} for s in stages if s.kind == kind]
        yield f"pipeline.{lists.get(kind, kind)}={json.dumps(choices if kind in lists else choices[-1])}"


def run_spec(
    path: str | Path, out_dir: str | Path | None = None, overrides: Iterable[str] = (), observer: Observer | None = None
) -> Run:
    """Load, compile and run a spec file; arguments and errors are those of ``run``."""
    plan = load_plan(path, overrides)
    return run_plan(plan, out_dir or Path("out", plan.spec.name), observer)


def run_plan(plan: Plan, out_dir: str | Path, observer: Observer | None = None, cache: Cache | None = None) -> Run:
    """Run a plan and write its run folder, which appears only when everything in it is finished.

    Equal plans give equal files, but for the timings in ``manifest.json``. An older run at ``out_dir`` is replaced.

    Args:
        plan: What to run.
        out_dir: The run folder.
        observer: Is told about progress; None prints notices only.
        cache: Where results of earlier runs are; by default where the environment says.

    Raises:
        InputError: The spec asks for what cannot be, or something at ``out_dir`` would be lost, see ``place_for``.
        StageError: A stage failed or broke its contract.
    """
    whole, result = _run(plan, Path(out_dir), observer or Observer(), cache, _everything)
    return Run(Path(out_dir), whole, result)


def write_run(
    plan: Plan, out_dir: str | Path, observer: Observer | None = None, cache: Cache | None = None
) -> dict[str, Any]:
    """Run a plan as ``run_plan`` does, and return the manifest alone: what was made is read only if a step needs it."""
    return _run(plan, Path(out_dir), observer or Observer(), cache, lambda *_: None)[0]


def _run(
    plan: Plan, out: Path, observer: Observer, cache: Cache | None, wanted: Callable[[Questions, dict[str, Any]], _T]
) -> tuple[dict[str, Any], _T]:
    """The manifest of a run, and what ``wanted`` makes of what it has made and of the manifest without files."""
    require_feasible(plan)
    place = place_for(out)
    cache = cache or usual_cache(observer.notice)
    made_of = of_run(plan) if cache else None  # now: files that the spec names may be edited during the run
    steps = Steps(plan, observer, cache)
    _tell_notices(plan, observer)
    try:
        with atomic_folder(place, observer.notice) as folder:
            facts, questions = _make(plan, folder, steps)
            result = wanted(questions, facts)
            whole = write_manifest(folder, facts, steps.timings())
            if cache and made_of:
                # most contents of its files are kept already, by the steps that wrote them
                files = [artifact["path"] for artifact in whole["artifacts"]]
                cache.keep(new_entry("run", made_of, whole["seconds"], facts, files), folder=folder)
        # only now, when the folder is in its place: observers may read it
        steps.tell("mlens_run_done", folder=out, manifest=whole)
    finally:
        if cache:
            cache.tidy()
        observer.stopped()
    return whole, result


def _everything(questions: Questions, facts: dict[str, Any]) -> RunResult:
    return replace(questions.result, manifest=facts)


def kept_run(
    plan: Plan, out_dir: str | Path, observer: Observer | None = None, cache: Cache | None = None
) -> dict[str, Any] | None:
    """Write the run folder of a plan that has been run before from the cache, without doing any of its steps.

    Args are those of ``run_plan``, and so are the errors.

    Returns:
        The manifest; None if something of the run is not in the cache, or must not be. Nothing is written then.
    """
    out, observer = Path(out_dir), observer or Observer()
    place = place_for(out)
    cache = cache or usual_cache(observer.notice)
    made_of = of_run(plan) if cache else None
    entry = cache.find(key_of(made_of)) if cache and made_of else None
    if cache is None or entry is None:
        return None
    steps = Steps(plan, observer, cache)
    try:
        with atomic_folder(place, observer.notice) as folder:
            if not cache.restore(entry, folder):
                raise _Incomplete
            # the same files may have been named by other paths when the run was kept
            facts = {**entry.facts, "inputs": outside_inputs(plan, Inputs())}
            whole = write_manifest(folder, facts, steps.timings())
    except _Incomplete:
        return None
    _tell_notices(plan, observer)
    observer.reused("the whole run")
    observer.stopped()
    steps.tell("mlens_run_done", folder=out, manifest=whole)
    return whole


class _Incomplete(Exception):
    """Some file of a run is not in the cache any more."""


def _tell_notices(plan: Plan, observer: Observer) -> None:
    for notice in plan.notices():
        observer.notice(notice)
    for failure in plan.registry.failures:
        observer.notice(f"{failure}; see 'mlens plugins'")


def _make(plan: Plan, folder: Path, steps: Steps) -> tuple[dict[str, Any], Questions]:
    """Fill a run folder with everything but the manifest; what the manifest shall say, and who knows the rest."""
    from magiclens.report.write import write_report

    inputs = Inputs()
    (folder / "spec.yaml").write_text(spec_text(plan, inputs), encoding="utf-8")
    copy_inputs(inputs, folder)
    drafts = make_lens(plan, steps.known(steps.part("pictures", plan.scene)), folder, steps)
    questions = Questions(plan, drafts, folder, steps)
    plugins = [*(step.plugin for step in plan.exporters), *(planned.plugin for planned in plan.analyses)]
    ours = all(plugin.built_in for plugin in plugins)
    with steps.beside(partial(export_lens, plan, drafts, folder, steps), ours):
        answers, scores = questions.analyse(), questions.scores()
        metrics = dict(questions.measures())
        for answer in answers:
            metrics |= answer.metrics
        facts = build_manifest(plan, inputs, drafts.painted.value, metrics, scores)
    with steps.beside(partial(questions.preflight, facts)):
        blocks = steps.part("figures", partial(questions.draw, answers, facts["metrics"]))
    steps.part("report", lambda: write_report(drafts.scene.value, facts, blocks, scores, folder))
    return facts, questions
