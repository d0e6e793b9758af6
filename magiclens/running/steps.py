"""Does the steps of a run one after the other: times them, reports progress, checks artifacts, names who fails."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any, TypeVar

from magiclens.contract.checks import BadArtifact
from magiclens.contract.stages import Progress
from magiclens.plan.blame import Blamed, blaming
from magiclens.plan.compile import Plan, Step
from magiclens.running.observers import Observer
from magiclens.running.termination import raise_if_terminated

T = TypeVar("T")


class Steps:
    """Does one step after the other, for one plan and one observer."""

    def __init__(self, plan: Plan, observer: Observer):
        self._registry, self._observer = plan.registry, observer
        self._facets = plan.lens.facets**2
        self._began = perf_counter()
        self._seconds: defaultdict[str, float] = defaultdict(float)

    def part(self, name: str, work: Callable[[], T], facets: int = 0) -> T:
        """A step of the pipeline itself, such as meshing.

        Args:
            name: What the observer shows, and the key of its time in ``timings``.
            work: What is done.
            facets: On how many facets, for rates; 0 if their number does not matter.
        """
        raise_if_terminated()
        self._observer.started(name, facets)
        began = perf_counter()
        result = work()
        raise_if_terminated()
        seconds = perf_counter() - began
        self._seconds[name] += seconds
        self._observer.finished(name, seconds)
        return result

    def stage(self, step: Step[Any], work: Callable[[Progress], T], check: Callable[[T], None]) -> T:
        """A step that a stage does; its artifact is checked against the contract, and observing hooks are called.

        Args:
            step: The stage and its plugin.
            work: Calls the stage; is given the function that it tells its progress.
            check: Checks what the stage returns; raises BadArtifact.

        Raises:
            StageError: The stage failed or broke its contract; the message names it.
        """
        before = self._seconds[step.name]
        artifact = self.part(step.name, partial(self._guarded, step, work, check), self._facets)
        # a stage may run several times, and its seconds add up; hooks are told those of this time
        seconds = self._seconds[step.name] - before
        self.tell("mlens_stage_done", stage=step.stage, artifact=artifact, seconds=seconds)
        return artifact

    def tell(self, hook: str, **facts: Any) -> None:
        """Call an observing hook of all plugins; the observer gets a notice of those that fail."""
        for complaint in self._registry.notify(hook, **facts):
            self._observer.notice(complaint)

    def timings(self) -> dict[str, float]:
        """Seconds by name, and in total; those of steps that were repeated are added up."""
        return {**self._seconds, "total": perf_counter() - self._began}

    def _guarded(self, step: Step[Any], work: Callable[[Progress], T], check: Callable[[T], None]) -> T:
        with blaming(str(step)):
            artifact = work(partial(self._observer.progressed, step.name))
            try:
                check(artifact)
            except BadArtifact as error:
                raise Blamed(f"{step} broke its contract: {error}") from error
            return artifact


class QuietSteps(Steps):
    """Steps on another lens than the run's, about which no plugin is told."""

    def tell(self, hook: str, **facts: Any) -> None:
        """Call no hook."""
