"""Does the steps of a run: times them, reports progress, checks artifacts, names who fails.

Steps follow each other, but for those that are done ``beside`` others in a thread of their own. What an earlier run has
kept is not done again; see ``magiclens.cache``.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import RLock
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from magiclens.cache.store import Cache, Damaged, new_entry
from magiclens.cache.unfinished import Unfinished
from magiclens.cache.values import NotPlain, borrowed, settled
from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.checks import BadArtifact, check_file
from magiclens.contract.stages import Exporter, Progress
from magiclens.kernels.resuming import going_through_loops_by
from magiclens.plan.blame import Blamed, blaming, locating
from magiclens.plan.compile import Plan, Step
from magiclens.running.ingredients import (
    Kept,
    MadeOf,
    generator_in,
    generator_state,
    key_of,
    known,
    of_pipeline,
    of_stage,
)
from magiclens.running.observers import Observer
from magiclens.running.termination import raise_if_terminated

_T = TypeVar("_T")
_LATER_WORK = {"rematch": ", again", "refine": ", refinement"}
"""What observers are told, beside its name, of the work that a stage does after it has done its first, by method."""


@dataclass
class Draws:
    """The random numbers of one kind of stage, which go on from call to call, past results that are kept as well.

    Attributes:
        rng: The generator in its present state.
    """

    rng: np.random.Generator


class Steps:
    """Does steps for one plan, one observer and one cache. Observers and hooks are called by one thread at a time."""

    def __init__(self, plan: Plan, observer: Observer, cache: Cache | None = None):
        """Without a cache everything is done, and nothing kept."""
        self.cache = cache
        self._plan, self._registry, self._observer = plan, plan.registry, observer
        self._facets = plan.lens.facets**2
        self._began = perf_counter()
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._telling = RLock()

    @contextmanager
    def beside(self, work: Callable[[], object], ours: bool = True) -> Iterator[None]:
        """Do steps in a thread of their own while the ``with`` block does others; it ends when both are done.

        Much of what a step does keeps one core busy; two such steps keep two.

        Args:
            work: Does steps that need nothing of what those of the block make, and the other way round. If it raises,
                the ``with`` statement does, unless the block has.
            ours: Whether no step is a plugin's. One might not work beside others, and what it writes to the standard
                output's descriptor could not be told from what they do: ``work`` is done before the block then.
        """
        if not ours:
            work()
            yield
            return
        with ThreadPoolExecutor(1, "beside") as pool:
            others = pool.submit(copy_context().run, work)
            yield
        others.result()

    def known(self, value: _T) -> Kept[_T]:
        """A value that is there already, such as the scene of the spec."""
        return known(value) if self.cache else Kept(None, lambda: value)

    def made_of(
        self, name: str, inputs: Mapping[str, Any], things: Iterable[Any] = (), packages: Iterable[str] = ()
    ) -> MadeOf | None:
        """What the result of a step of the pipeline is made of, see ``of_pipeline``; None without a cache."""
        return of_pipeline(name, inputs, things, packages) if self.cache else None

    def part(self, name: str, work: Callable[[], _T], facets: int = 0) -> _T:
        """A step of the pipeline itself, such as meshing.

        Args:
            name: What the observer shows, and the key of its time in ``timings``.
            work: What is done.
            facets: On how many facets, for rates; 0 if their number does not matter.
        """
        raise_if_terminated()
        self._say("started", name, facets)
        began = perf_counter()
        result = work()
        raise_if_terminated()
        seconds = perf_counter() - began
        self._seconds[name] += seconds
        self._say("finished", name, seconds)
        return result

    def derived(self, name: str, work: Callable[..., _T], shown: bool = True, **inputs: Kept[Any]) -> Kept[_T]:
        """What follows from results so quickly that it is not kept, but made when it is asked for.

        Args:
            name: The step's name.
            work: Is given the inputs' values, in their order.
            shown: Whether it is a ``part`` that observers are told of.
            inputs: What it is made from.
        """

        def make() -> _T:
            call = partial(work, *(each.value for each in inputs.values()))
            return self.part(name, call) if shown else call()

        return Kept(self.made_of(name, inputs), make)

    def measured(self, name: str, work: Callable[..., _T], **inputs: Kept[Any]) -> Kept[_T]:
        """A small result of a ``part`` that takes long, so that it is kept; arguments are those of ``derived``."""
        made_of = self.made_of(name, inputs)
        return self._made(name, made_of, inputs, lambda _, *values: self.part(name, partial(work, *values)))

    def stage(
        self,
        step: Step[Any],
        method: str,
        inputs: Mapping[str, Kept[Any]],
        check: Callable[..., None],
        draws: Draws | None = None,
    ) -> Kept[Any]:
        """A step that a stage does; its artifact is checked against the contract, and observing hooks are called.

        If the artifact is in the cache, the stage is not called, and observing hooks are not either.

        Args:
            step: The stage and its plugin.
            method: The name of its method.
            inputs: The method's arguments before ``rng`` and ``progress``, by name and in their order.
            check: Checks what the stage returns; raises BadArtifact.
            draws: The random numbers that the method is given; None for one that has no ``rng``.

        Raises:
            StageError: The stage failed or broke its contract; the message names it.
        """

        name = step.name + _LATER_WORK.get(method, "")

        def work(rng: np.random.Generator | None, *values: Any) -> Any:
            call = partial(getattr(step.stage, method), *values, *([] if rng is None else [rng]))
            return self._done(step, call, check, name)

        state = generator_state(draws.rng) if draws else None
        made_of = of_stage(step, method, inputs, state) if self.cache else None
        return self._made(name, made_of, inputs, work, draws)

    def export(self, step: Step[Exporter], scene: Kept[Scene], solid: Kept[Solid], folder: Path) -> None:
        """A step that an exporter does: it writes files into a run folder. Raises as ``stage``."""
        name = f"lens{step.stage.suffix}"

        def export(own: Path) -> None:
            given = scene.value, solid.value  # before the step begins: they may have to be made themselves

            def write(_: Progress) -> Path:
                path = own / name
                try:
                    step.stage.export(*given, path)
                except OSError as error:  # a disk that is full does not say which file it had no room for
                    error.filename = Path(os.fsdecode(error.filename or path)).name
                    raise
                return path

            self._done(step, write, check_file, step.name)

        made_of = of_stage(step, "export", {"scene": scene, "solid": solid}, None) if self.cache else None
        self.files(step.name, made_of, folder, export)

    def files(
        self, name: str, made_of: MadeOf | None, folder: Path, work: Callable[[Path], _T], shown: bool = True
    ) -> _T:
        """A step that writes files into a run folder, or gets them from the cache.

        Args:
            name: The step's name.
            made_of: What the files depend on; None if they must not be kept.
            folder: The run folder.
            work: Writes them into the folder that it is given, which may be another one from which they are moved
                then. It may return JSON data that is kept with them.
            shown: Whether observers are told if the files come from the cache.

        Returns:
            What ``work`` has returned, now or when the files were kept.
        """
        cache = self.cache
        if cache is None or made_of is None:
            return work(folder)
        entry = cache.find(key_of(made_of))
        if entry and cache.restore(entry, folder):
            if shown:
                self._say("reused", name)
            facts: _T = entry.facts
            return facts
        # a folder of its own tells which files are this step's
        with TemporaryDirectory(prefix=".", dir=folder) as own:
            began = perf_counter()
            facts = work(Path(own))
            written = files_in(Path(own))
            cache.keep(new_entry(name, made_of, perf_counter() - began, facts, written), folder=Path(own))
            for path in written:
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                Path(own, path).replace(folder / path)
        return facts

    def tell(self, hook: str, **facts: Any) -> None:
        """Call an observing hook of all plugins; the observer gets a notice of those that fail."""
        with self._telling:
            for complaint in self._registry.notify(hook, **facts):
                self._observer.notice(complaint)

    def timings(self) -> dict[str, float]:
        """Seconds by name, and in total; those of steps that were repeated are added up."""
        return {**self._seconds, "total": perf_counter() - self._began}

    def holds(self, question: Callable[[], bool]) -> bool:
        """The answer to a question about results, on which it depends which steps follow."""
        return question()

    def _say(self, what: str, *about: Any) -> None:
        """Call a method of the observer."""
        with self._telling:
            getattr(self._observer, what)(*about)

    def _made(
        self,
        name: str,
        made_of: MadeOf | None,
        inputs: Mapping[str, Kept[Any]],
        work: Callable[..., Any],
        draws: Draws | None = None,
    ) -> Kept[Any]:
        """A result from the cache, or made now. ``work`` is given a generator or None, and the inputs' values."""
        cache, key = self.cache, made_of and key_of(made_of)

        def make(rng: np.random.Generator | None) -> Any:
            values = [each.value for each in inputs.values()]  # first: they may have to be made themselves
            began = perf_counter()
            unfinished = Unfinished(cache, key, name, partial(self._say, "notice")) if cache and key else None
            with going_through_loops_by(unfinished.loop if unfinished else None):
                result = settled(work(rng, *values))
            if cache and made_of and unfinished:
                entry = new_entry(name, made_of, perf_counter() - began, rng=generator_state(rng) if rng else None)
                with suppress(NotPlain):  # a plugin's artifact of a class of its own is made every time
                    cache.keep(entry, result, values)
                unfinished.forget()
            return result

        entry = cache.find(key) if cache and key else None
        if cache is None or entry is None:
            result = make(draws.rng if draws else None)
            return Kept(key, lambda: result) if key else self.known(result)
        before = draws.rng if draws else None
        if draws and entry.rng:
            draws.rng = generator_in(entry.rng)  # the next call draws what it would have drawn
        self._say("reused", name)

        def get() -> Any:
            places = borrowed(entry.value)
            given = {k: each.value for k, each in enumerate(inputs.values()) if k in places}
            try:
                return cache.value(entry, given)
            except Damaged:
                return make(before)

        return Kept(key, get)

    def _done(self, step: Step[Any], work: Callable[[Progress], _T], check: Callable[[_T], None], name: str) -> _T:
        """Let a stage work, check its artifact, and tell hooks; observers are told ``name``."""
        before = self._seconds.pop(step.name, 0.0)
        artifact = self.part(name, partial(self._guarded, step, work, check, name), self._facets)
        # a stage may run several times, and its seconds add up; hooks are told those of this time
        seconds = self._seconds.pop(name)
        self._seconds[step.name] = before + seconds
        self.tell("mlens_stage_done", stage=step.stage, artifact=artifact, seconds=seconds)
        return artifact

    def _guarded(self, step: Step[Any], work: Callable[[Progress], _T], check: Callable[[_T], None], name: str) -> _T:
        with locating(self._plan.document, self._plan.place(step)), blaming(str(step)):
            artifact = work(partial(self._say, "progressed", name))
            try:
                check(artifact)
            except BadArtifact as error:
                raise Blamed(f"{step} broke its contract: {error}") from error
            return artifact


class QuietSteps(Steps):
    """Steps on another lens than the run's, about which no plugin is told."""

    def tell(self, hook: str, **facts: Any) -> None:
        """Call no hook."""


def files_in(folder: Path) -> list[str]:
    """Paths of all files below a folder, relative to it."""
    return [path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if path.is_file()]
