"""What all stages have in common."""

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
DAY_S = 86_400.0


@dataclass(frozen=True)
class Made:
    """What a stage was given and made: its artifact, digests of the inputs before and after, fractions it reported."""

    given: tuple[Any, ...]
    artifact: Any
    before: str
    after: str
    progress: Sequence[float]


class StageContract:
    """Base of the contracts. They give ``stage`` the inputs of each scene, and look at its artifact.

    ``scenes``: functions without arguments, each of which makes a Scene.
    """

    stage: Stage
    scenes: ClassVar[Sequence[Callable[[], Scene]]] = (one_view, two_turns)

    def given(self, scene: Scene) -> tuple[Any, ...]:
        """The stage's inputs."""
        return (scene,)

    def work(self, given: tuple[Any, ...], rng: np.random.Generator, progress: Progress) -> Any:
        """Call the stage; the artifact."""
        raise NotImplementedError

    def check(self, given: tuple[Any, ...], artifact: Any) -> None:
        """What a run checks too. Raises BadArtifact."""
        raise NotImplementedError

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Every test that wants a scene gets each of them."""
        if "scene" in metafunc.fixturenames:
            names = [getattr(make, "__name__", str(k)) for k, make in enumerate(self.scenes)]
            metafunc.parametrize("scene", self.scenes, indirect=True, ids=names, scope="class")

    @pytest.fixture(scope="class")
    @classmethod
    def scene(cls, request: pytest.FixtureRequest) -> Scene:
        """One of the scenes."""
        made: Scene = request.param()
        return made

    @pytest.fixture(scope="class")
    @classmethod
    def made(cls, scene: Scene) -> Made:
        """The stage's work on the scene, done once."""
        contract, progress = cls(), list[float]()
        given = contract.given(scene)
        before = digest(given)
        artifact = contract.work(given, np.random.default_rng(SEED), progress.append)
        return Made(given, artifact, before, digest(given), progress)

    def test_its_class_is_accepted(self) -> None:
        """By the registry: ``kind``, ``type``, ``version`` and methods are there."""
        flaw = stage_flaw(type(self.stage))
        assert flaw is None, flaw

    def test_its_options_can_be_written_to_a_spec_and_read_again(self) -> None:
        """A run folder's ``spec.yaml`` has every option, and must mean the same."""
        written = json.loads(json.dumps(self.stage.model_dump(mode="json", context={"inputs": None})))
        assert type(self.stage).model_validate(written) == self.stage, f"read again, {written} is another stage"

    def test_its_artifact_is_valid(self, made: Made) -> None:
        """Types, shapes, finite numbers."""
        try:
            self.check(made.given, made.artifact)
        except BadArtifact as error:
            pytest.fail(f"the artifact breaks the contract: {error}")

    def test_equal_seeds_give_equal_artifacts(self, made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
        """Whatever Python's and numpy's global generators are at, and on another day."""
        random.seed(SEED)
        np.random.seed(SEED)  # noqa: NPY002
        _tomorrow(monkeypatch)
        again = self.work(made.given, np.random.default_rng(SEED), lambda _: None)
        assert digest(again) == digest(made.artifact), (
            "the same inputs and the same rng gave two different artifacts; draw from rng alone, write no dates"
        )

    def test_inputs_stay_as_they_are(self, made: Made) -> None:
        """They are read-only: whoever comes next gets the same ones."""
        assert made.after == made.before, "the stage has changed what it was given; work on copies"

    def test_progress_is_told_in_fractions_that_grow(self, made: Made) -> None:
        """From 0 to 1, for the progress bar; none at all is fine."""
        told = np.array([0.0, *made.progress, 1.0])
        assert (np.diff(told) >= 0).all(), f"progress was told {list(made.progress)}; fractions of 1, never less"


def digest(thing: Any) -> str:
    """A hash of artifacts, arrays, matrices, and what holds them."""
    hashed = hashlib.sha256()
    _feed(hashed.update, thing)
    return hashed.hexdigest()


def _feed(update: Callable[[bytes], None], thing: Any) -> None:
    if isinstance(thing, np.ndarray):
        update(f"{thing.dtype} {thing.shape}".encode())
        update(np.ascontiguousarray(thing).tobytes())
    elif is_dataclass(thing):
        _feed(update, [getattr(thing, f.name) for f in fields(thing)])
    elif isinstance(thing, Mapping):
        _feed(update, [*thing.keys(), *thing.values()])
    elif hasattr(thing, "indptr"):
        _feed(update, [thing.data, thing.indices, thing.indptr])
    elif isinstance(thing, list | tuple):
        update(f"{len(thing)} of".encode())
        for part in thing:
            _feed(update, part)
    else:
        update(thing if isinstance(thing, bytes) else repr(thing).encode())


def _tomorrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Move the clock that files are dated by."""
    now, now_ns, local, utc = time.time, time.time_ns, time.localtime, time.gmtime
    monkeypatch.setattr(time, "time", lambda: now() + DAY_S)
    monkeypatch.setattr(time, "time_ns", lambda: now_ns() + round(DAY_S * 1e9))
    monkeypatch.setattr(time, "localtime", lambda when=None: local(now() + DAY_S if when is None else when))
    monkeypatch.setattr(time, "gmtime", lambda when=None: utc(now() + DAY_S if when is None else when))
