"""Signals end a run with the right exit code, and nothing of it is left."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from magiclens.contract.artifacts import Assignment, HeightField, Scene
from magiclens.contract.errors import Terminated
from magiclens.plan.compile import load_plan
from magiclens.running.pipeline import run_plan
from magiclens.running.termination import end_on_sigterm
from toys import TOYS, SpecWriter, ToyIntegrator, registry_of


@pytest.fixture
def listening() -> Iterator[None]:
    """SIGTERM ends runs, as on the command line; afterwards it does what it did."""
    before = signal.getsignal(signal.SIGTERM)
    end_on_sigterm()
    yield
    end_on_sigterm()  # forgets what has come
    signal.signal(signal.SIGTERM, before)


class Deaf(ToyIntegrator):
    """Catches every exception, as some libraries do while they are imported."""

    def integrate(self, scene: Scene, assignment: Assignment, progress: Any = None) -> HeightField:
        with suppress(BaseException):
            os.kill(os.getpid(), signal.SIGTERM)
        return super().integrate(scene, assignment)


class Interrupted(ToyIntegrator):
    """Is interrupted by its user."""

    def integrate(self, scene: Scene, assignment: Assignment, progress: Any = None) -> HeightField:
        os.kill(os.getpid(), signal.SIGINT)
        return super().integrate(scene, assignment)


@pytest.mark.usefixtures("listening")
@pytest.mark.parametrize(("stage", "error"), [(Deaf, Terminated), (Interrupted, KeyboardInterrupt)])
def test_a_signal_ends_the_run_even_if_a_library_catches_it(
    stage: type[ToyIntegrator], error: type[BaseException], write_spec: SpecWriter, tmp_path: Path
) -> None:
    registry = registry_of(*(toy for toy in TOYS if toy is not ToyIntegrator), stage)
    with pytest.raises(error):
        run_plan(load_plan(write_spec(), (), registry), tmp_path / "out")
    assert os.listdir(tmp_path) == ["toy.yaml"]
