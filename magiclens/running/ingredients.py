"""What the results of steps are made of, from which their keys in the cache follow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, Generic, TypeVar

import numpy as np

from magiclens.cache.sources import UnknownSources, processor, required_versions, source_hashes
from magiclens.cache.store import file_digest
from magiclens.cache.values import NotPlain, described, digest_of
from magiclens.config.fields import Inputs
from magiclens.plan.blame import blaming
from magiclens.plan.compile import Plan, Step
from magiclens.plan.registry import Registry
from magiclens.running.manifest import spec_text, versions

_T = TypeVar("_T")
T_co = TypeVar("T_co", covariant=True)

MadeOf = dict[str, Any]
"""What a result is made of, as JSON data: its digest is the key of the result."""

_MAGICLENS = "magiclens"


class Kept(Generic[T_co]):
    """A result that is known by its key before it is there: it is read from the cache, or made, when it is asked for.

    Attributes:
        made_of: What describes it in what is made from it: its key, or its content. None if nothing does: what is made
            from it then cannot be kept either.
    """

    def __init__(self, made_of: Any, get: Callable[[], T_co]):
        self.made_of = made_of
        self._get: Callable[[], T_co] | None = get
        self._asking = Lock()

    @property
    def value(self) -> T_co:
        """The result itself."""
        with self._asking:  # two threads may need it
            if self._get is not None:
                self._found, self._get = self._get(), None  # which may hold inputs that nobody else needs any more
            return self._found


class HashedInputs(Inputs):
    """Names the files of a spec by their content: what they are called, and where they are, changes no result."""

    def portable(self, path: Path) -> str:
        """The hash of a file."""
        return file_hash(path)


def file_hash(path: Path) -> str:
    """SHA-256 of a file."""
    found = path.stat()
    return _hash_of(path, found.st_mtime_ns, found.st_size)


def known(value: _T) -> Kept[_T]:
    """A result that is there already, known by its content."""
    try:
        return Kept(described(value), lambda: value)
    except NotPlain:
        return Kept(None, lambda: value)


def of_stage(step: Step[Any], method: str, inputs: Mapping[str, Kept[Any]], rng: MadeOf | None) -> MadeOf | None:
    """What a stage's result is made of.

    Args:
        step: The stage and its plugin.
        method: The method that is called.
        inputs: What it is given, by name.
        rng: The random generator's state, see ``generator_state``; None if the stage is given none.

    Returns:
        None if the result must not be kept: the stage says so, its code is not in files, or an input is of this kind.
    """
    stage = step.stage
    if not getattr(stage, "repeatable", True) or any(each.made_of is None for each in inputs.values()):
        return None
    try:
        sources = source_hashes([type(stage)])
    except UnknownSources:
        return None
    return {
        "step": f"{step.name} {method}",
        "options": step.choice(HashedInputs()),
        "version": stage.version,
        "surroundings": _surroundings(step),
        **_code(sources, [step.plugin.package]),
        "inputs": {name: each.made_of for name, each in inputs.items()},
        "rng": rng,
    }


def of_pipeline(
    step: str, inputs: Mapping[str, Any], things: Iterable[Any] = (), packages: Iterable[str] = ()
) -> MadeOf | None:
    """What the result of a step of the pipeline itself is made of.

    Args:
        step: The step's name.
        inputs: What it depends on, by name: JSON data, or ``Kept``.
        things: Classes, functions and objects of plugins that take part.
        packages: The packages that they belong to.

    Returns:
        None if the result must not be kept, as in ``of_stage``.
    """
    plain = {name: each.made_of if isinstance(each, Kept) else each for name, each in inputs.items()}
    if any(isinstance(each, Kept) and each.made_of is None for each in inputs.values()):
        return None
    try:
        return {"step": step, **_code(source_hashes(things), packages), "inputs": plain}
    except UnknownSources:
        return None


def of_run(plan: Plan) -> MadeOf | None:
    """What all files of a run folder but its timings are made of; None if some of it must not be kept."""
    everything = [plan.scenario, *(step.stage for step in plan.steps), *(each.analysis for each in plan.analyses)]
    if not all(getattr(each, "repeatable", True) for each in everything):
        return None
    inputs = Inputs()
    spec = spec_text(plan, inputs)
    known_by = {
        "spec": spec,
        "files": {name: file_hash(path) for path, name in inputs.items()},
        "versions": versions(plan),
        "stages": [[step.name, step.stage.version, _surroundings(step)] for step in plan.steps],
    }
    return of_pipeline("run", known_by, *whole_registry(plan.registry))


def whole_registry(registry: Registry) -> tuple[list[Any], set[str]]:
    """All that is contributed, and by which packages: what is given a plan may look for anything in its registry."""
    contributed = registry.contributions.values()
    return [each.value for each in contributed], {each.plugin.package for each in contributed}


def key_of(made_of: MadeOf) -> str:
    """The key of a result."""
    return digest_of(made_of)


def generator_state(rng: np.random.Generator) -> MadeOf:
    """All of a random generator, as JSON data."""
    seed: Any = rng.bit_generator.seed_seq
    return {
        "entropy": seed.entropy,
        "spawn_key": [*seed.spawn_key],
        "spawned": seed.n_children_spawned,
        "state": rng.bit_generator.state,
    }


def generator_in(state: MadeOf) -> np.random.Generator:
    """A new random generator in a state of ``generator_state``."""
    seed = np.random.SeedSequence(
        state["entropy"], spawn_key=tuple(state["spawn_key"]), n_children_spawned=state["spawned"]
    )
    rng = np.random.default_rng(seed)
    rng.bit_generator.state = state["state"]
    return rng


def _code(sources: Mapping[str, str], packages: Iterable[str]) -> MadeOf:
    found = [required_versions(package) for package in sorted({_MAGICLENS, *packages})]
    merged = {name: version for each in found for name, version in each.items()}
    return {"sources": dict(sources), "packages": merged, "processor": processor()}


def _surroundings(step: Step[Any]) -> Any:
    """What a stage says that it depends on besides; a stage need not inherit from our base, and then says nothing."""
    ask = getattr(step.stage, "surroundings", None)
    with blaming(f"{step}: surroundings"):
        return described(ask()) if ask else None


@lru_cache(maxsize=256)
def _hash_of(path: Path, changed: int, size: int) -> str:
    return file_digest(path)
