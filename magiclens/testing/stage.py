"""The contract that all stages share."""

from __future__ import annotations

import hashlib
import json
import random
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from magiclens.contract.artifacts import Scene
from magiclens.contract.checks import BadArtifact
from magiclens.contract.stages import Progress, Stage
from magiclens.plan.flaws import stage_flaw
from magiclens.testing.scenes import one_view, two_turns

SEED = 20
"""Seed of the generators that stages are tested with."""

_DAY_S = 86_400.0
"""Seconds of a day."""


@dataclass(frozen=True)
class StageCall:
    """One call of a stage, made for all tests of a contract.

    Attributes:
        inputs: What the stage was called with, without the generator and the progress callback.
        artifact: What it returned.
        before: Digest of the inputs before the call.
        after: Digest of the inputs after the call.
        progress: The fractions that it reported.
    """

    inputs: tuple[Any, ...]
    artifact: Any
    before: str
    after: str
    progress: Sequence[float]


class StageContract:
    """Base of the contracts of all kinds of stages.

    Attributes:
        stage: The stage to test; a subclass sets it.
        scenes: Functions without arguments, each of which makes a scene that the stage is tested with.
    """

    stage: Stage
    scenes: ClassVar[Sequence[Callable[[], Scene]]] = (one_view, two_turns)

    def inputs(self, scene: Scene) -> tuple[Any, ...]:
        """The inputs of the stage for a scene."""
        return (scene,)

    def call(self, inputs: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Any:
        """Call the stage with its inputs, and return its artifact."""
        raise NotImplementedError

    def check(self, inputs: tuple[Any, ...], artifact: Any) -> None:
        """Check the artifact as a run does; raises BadArtifact."""
        raise NotImplementedError

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Run every test that has an argument ``scene`` with each of the scenes."""
        if "scene" in metafunc.fixturenames:
            names = [getattr(make, "__name__", str(k)) for k, make in enumerate(self.scenes)]
            metafunc.parametrize("scene", self.scenes, indirect=True, ids=names, scope="class")

    @pytest.fixture(scope="class")
    @classmethod
    def scene(cls, request: pytest.FixtureRequest) -> Scene:
        """One of the scenes."""
        scene: Scene = request.param()
        return scene

    @pytest.fixture(scope="class")
    @classmethod
    def outcome(cls, scene: Scene) -> StageCall:
        """What the stage makes of the scene; the stage is called once for all tests."""
        contract, progress = cls(), list[float]()
        inputs = contract.inputs(scene)
        before = digest(inputs)
        artifact = contract.call(inputs, np.random.default_rng(SEED), progress.append)
        return StageCall(inputs, artifact, before, digest(inputs), progress)

    def test_its_class_is_accepted(self) -> None:
        """The registry accepts it: ``kind``, ``type``, ``version`` and the methods exist."""
        flaw = stage_flaw(type(self.stage))
        assert flaw is None, flaw

    def test_its_options_can_be_written_to_a_spec_and_read_again(self) -> None:
        """A run folder's ``spec.yaml`` has every option, and must give the same stage again."""
        # through JSON, which has the same values as YAML: anything else would not survive in a file
        written = json.loads(json.dumps(self.stage.model_dump(mode="json", context={"inputs": None})))
        assert type(self.stage).model_validate(written) == self.stage, f"read again, {written} is another stage"

    def test_its_artifact_is_valid(self, outcome: StageCall) -> None:
        """Its type, its shapes and its numbers are those that the contract promises."""
        try:
            self.check(outcome.inputs, outcome.artifact)
        except BadArtifact as error:
            pytest.fail(f"the artifact breaks the contract: {error}")

    def test_equal_seeds_give_equal_artifacts(self, outcome: StageCall, monkeypatch: pytest.MonkeyPatch) -> None:
        """This holds whatever state the global generators of Python and numpy are in, and on another day."""
        # another state than in the first call, so that a stage that uses the global generators gives something else
        random.seed(SEED)
        np.random.seed(SEED)  # noqa: NPY002
        _set_clock_to_tomorrow(monkeypatch)
        again = self.call(outcome.inputs, np.random.default_rng(SEED), lambda _: None)
        assert digest(again) == digest(outcome.artifact), (
            "the same inputs and the same rng gave two different artifacts; draw from rng alone, write no dates"
        )

    def test_inputs_stay_as_they_are(self, outcome: StageCall) -> None:
        """The next stage gets the same inputs."""
        assert outcome.after == outcome.before, "the stage has changed its inputs; work on copies"

    def test_progress_is_told_in_fractions_that_grow(self, outcome: StageCall) -> None:
        """They go from 0 to 1, for the progress bar; a stage need not report any."""
        assert_progress(outcome)


def assert_progress(outcome: StageCall) -> None:
    """Fail unless the fractions that were reported are from 0 to 1 and do not descend."""
    reported = np.array([0.0, *outcome.progress, 1.0])
    assert (np.diff(reported) >= 0).all(), (
        f"progress was told {list(outcome.progress)}; it takes fractions from 0 to 1 that do not descend"
    )


def digest(thing: Any) -> str:
    """A hash of artifacts, arrays and sparse matrices, and of lists and mappings of them."""
    hashed = hashlib.sha256()
    _feed(hashed.update, thing)
    return hashed.hexdigest()


def _feed(update: Callable[[bytes], None], thing: Any) -> None:
    if isinstance(thing, np.ndarray):
        # equal bytes of another type or shape are another array
        update(f"{thing.dtype} {thing.shape}".encode())
        update(np.ascontiguousarray(thing).tobytes())
    elif is_dataclass(thing):
        _feed(update, [getattr(thing, f.name) for f in fields(thing)])
    elif isinstance(thing, Mapping):
        _feed(update, [*thing.keys(), *thing.values()])
    elif hasattr(thing, "indptr"):  # a sparse matrix of scipy, which is not imported for this
        _feed(update, [thing.data, thing.indices, thing.indptr])
    elif isinstance(thing, list | tuple):
        update(f"{len(thing)} of".encode())
        for part in thing:
            _feed(update, part)
    else:
        update(thing if isinstance(thing, bytes) else repr(thing).encode())


def _set_clock_to_tomorrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Move the clock of this process by a day; writers of files take dates from it."""
    now, now_ns, local, utc = time.time, time.time_ns, time.localtime, time.gmtime
    monkeypatch.setattr(time, "time", lambda: now() + _DAY_S)
    monkeypatch.setattr(time, "time_ns", lambda: now_ns() + round(_DAY_S * 1e9))
    monkeypatch.setattr(time, "localtime", lambda when=None: local(now() + _DAY_S if when is None else when))
    monkeypatch.setattr(time, "gmtime", lambda when=None: utc(now() + _DAY_S if when is None else when))
