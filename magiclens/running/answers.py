"""What is found out about a finished lens: analyses, their figures, and preflight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magiclens.analysis.base import Findings
from magiclens.config.model import ReportSpec
from magiclens.contract.checks import BadArtifact
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.plan.blame import blaming
from magiclens.plan.compile import Plan, PlannedAnalysis
from magiclens.running.ingredients import HashedInputs, Kept, MadeOf, file_hash, whole_registry
from magiclens.running.making import Drafts
from magiclens.running.steps import Steps
from magiclens.running.writing import write_figure_pictures

if TYPE_CHECKING:
    from magiclens.images.score import Score
    from magiclens.preflight.finding import Preflight


@dataclass(frozen=True)
class Answer:
    """What an analysis has found.

    Attributes:
        planned: The analysis.
        metrics: Numbers for the manifest.
        findings: All that it has found. If only numbers and files were kept, it is computed again to draw figures.
    """

    planned: PlannedAnalysis
    metrics: dict[str, float]
    findings: Kept[Findings | None]


class Questions:
    """Asks about the lens of one run."""

    def __init__(self, plan: Plan, drafts: Drafts, folder: Path, steps: Steps):
        self._plan, self._drafts, self._folder, self._steps = plan, drafts, folder, steps
        self._shown_plan = _without_files(plan)
        self._described_plan = self._shown_plan.resolved(HashedInputs()) if steps.cache else {}

    @cached_property
    def result(self) -> RunResult:
        """Everything that the run has made, without a manifest; read from the cache as soon as somebody asks for it."""
        return self._drafts.result(self._plan, self._steps.cache)

    def scores(self) -> dict[str, list[Score]]:
        """How near the pictures of each renderer are to their targets."""

        def compare(_: Path) -> dict[str, list[tuple[float, float, float]]]:
            from magiclens.images.score import score

            views = self._drafts.scene.value.views
            return {
                renderer: [astuple(score(picture, v.target)) for picture, v in zip(pictures.value, views, strict=True)]
                for renderer, pictures in self._drafts.renders.items()
            }

        from magiclens.images.score import Score

        made_of = self._steps.made_of("scores", {"scene": self._drafts.scene, **self._drafts.renders})
        found = self._steps.files("scores", made_of, self._folder, compare, shown=False)
        return {renderer: [Score(*each) for each in of_views] for renderer, of_views in found.items()}

    def measures(self) -> dict[str, float]:
        """The metrics of all artifacts."""

        def collect(_: Path) -> dict[str, float]:
            made = self.result
            every = (made.candidates, made.assignment, made.height_field, made.unfinished, made.solid)
            return {name: float(value) for each in every for name, value in each.metrics.items()}

        made_of = self._made_of("metrics")
        return self._steps.files("metrics", made_of, self._folder, collect, shown=False)

    def analyse(self) -> list[Answer]:
        """Let all analyses of the plan answer, in their order; pictures that they find are written."""
        answers = (self._answer(planned) for planned in self._plan.analyses)
        return [answer for answer in answers if answer]

    def draw(self, answers: Sequence[Answer], metrics: Mapping[str, float | None]) -> list[str]:
        """Draw the figures of answers, and write them; some at a time if no plugin draws.

        Args:
            answers: What the analyses have found.
            metrics: Those of the manifest, of which figures may tell; of all else in it they know nothing.

        Returns:
            The figures as blocks of the report's page, in order.
        """
        from magiclens.kernels.threads import side_by_side

        shown = Kept(None, lambda: replace(self.result, manifest={"metrics": metrics}))
        ours = all(answer.planned.plugin.built_in for answer in answers)
        blocks = (side_by_side if ours else map)(partial(self._blocks, metrics, shown), answers)
        return [block for of_answer in blocks for block in of_answer]

    def preflight(self, facts: dict[str, Any]) -> None:
        """Check what was exported, if it is a mesh, and write the preflight's page.

        Args:
            facts: The manifest as ``build_manifest`` returns it.
        """
        from magiclens.preflight.mesh_file import mesh_files

        meshes = mesh_files(self._folder)
        if not meshes:
            return

        def write(folder: Path) -> None:
            from magiclens.preflight.checks import run_preflight
            from magiclens.preflight.page import write_preflight

            solid = self._drafts.solid.value
            check = partial(run_preflight, self._folder, facts, self._shown_plan, solid, keep)
            self._steps.part("preflight", lambda: write_preflight(check(), folder))

        def keep(check: Callable[[], Preflight]) -> Preflight:
            from magiclens.preflight.finding import Preflight

            made_of = self._made_of("findings", facts=seen)
            work = lambda _: check().as_plain()  # noqa: E731
            return Preflight.from_plain(self._steps.files("findings", made_of, self._folder, work, shown=False))

        seen = {name: facts[name] for name in ("name", "metrics", "views")}
        hashes = {path.name: file_hash(path) for path in meshes} if self._steps.cache else {}
        made_of = self._made_of("preflight", facts=seen, meshes=hashes)
        self._steps.files("preflight", made_of, self._folder, write)

    def _answer(self, planned: PlannedAnalysis) -> Answer | None:
        findings = Kept(None, partial(self._findings, planned))

        def compute(folder: Path) -> dict[str, float] | None:
            found = self._steps.part(planned.name, lambda: findings.value)
            if found is None:
                return None
            write_figure_pictures(found.pictures, folder)
            return {name: float(value) for name, value in found.metrics.items()}

        made_of = self._made_of_answer(f"analysis {planned.name}", planned)
        metrics = self._steps.files(planned.name, made_of, self._folder, compute)
        return None if metrics is None else Answer(planned, metrics, findings)

    def _findings(self, planned: PlannedAnalysis) -> Findings | None:
        result = self.result
        with blaming(str(planned)):
            findings = planned.analysis.compute(self._shown_plan, result)
            if findings is not None and not isinstance(findings, Findings):
                raise BadArtifact(f"it found a {type(findings).__name__} instead of Findings")
            return findings

    def _blocks(self, metrics: Mapping[str, float | None], shown: Kept[RunResult], answer: Answer) -> list[str]:
        from magiclens.report.write import write_figure

        def draw(folder: Path) -> list[str]:
            return [write_figure(figure, folder) for figure in self._figures(answer, shown.value)]

        name = f"figures of {answer.planned.name}"
        made_of = self._made_of_answer(name, answer.planned, metrics=dict(metrics))
        return self._steps.files(name, made_of, self._folder, draw, shown=False)

    def _figures(self, answer: Answer, result: RunResult) -> list[Figure]:
        findings = answer.findings.value
        with blaming(str(answer.planned)):
            return list(answer.planned.analysis.figures(result, findings))

    def _made_of_answer(self, name: str, planned: PlannedAnalysis, **more: Any) -> MadeOf | None:
        return self._made_of(name, **more) if getattr(planned.analysis, "repeatable", True) else None

    def _made_of(self, name: str, **more: Any) -> MadeOf | None:
        """What a step is made of that sees the plan and all that was made by it."""
        things, packages = whole_registry(self._plan.registry)
        return self._steps.made_of(name, {"plan": self._described_plan, **self._drafts.each, **more}, things, packages)


def _without_files(plan: Plan) -> Plan:
    """The plan as analyses see it, without what is no property of the lens: its name, its files, what else is asked.

    So no analysis can depend on these by accident, and what was found is right for every plan that differs in nothing
    else.
    """
    pipeline = plan.spec.pipeline.model_copy(update={"exporters": []})
    spec = plan.spec.model_copy(update={"name": "lens", "pipeline": pipeline, "report": ReportSpec()})
    return replace(plan, spec=spec, exporters=())
