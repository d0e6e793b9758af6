"""The first run: kernels are compiled in a child process beside the run, and the run says so."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from numba.core.dispatcher import Dispatcher

from magiclens.analysis.stable_zone import seen_from
from magiclens.analysis.tolerances import tolerances
from magiclens.plan.compile import load_plan
from magiclens.running import compilation
from magiclens.running.compilation import compiling_ahead, small_scene
from magiclens.running.observers import Observer

SPEC = """\
scenario: {type: single, source: {type: circles, seed: 7}, target: {art: heart}}
lens: {size: 24mm, facets: 8, microfacets: 4, thickness: 20mm}
pipeline: {matcher: {type: exhaustive, scales: [0.5], candidates: 4, polish: 1}}
"""


class Watching(Observer):
    """Collects what it is told."""

    def __init__(self) -> None:
        self.notices: list[str] = []
        self.names: list[str] = []

    def started(self, name: str, facets: int) -> None:
        self.names.append(name)

    def notice(self, text: str) -> None:
        self.notices.append(text)


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SPEC, encoding="utf-8")
    return path


def kernel_of(module: str) -> object:
    """A kernel that no one has compiled yet, as if it were of that module."""

    def double(x: float) -> float:
        return 2 * x

    double.__module__ = module
    return njit(double)


def test_the_first_compilation_is_announced_once_and_starts_a_child(spec: Path) -> None:
    watching = Watching()
    with compiling_ahead(spec, (), watching) as observer:
        for _ in range(2):
            assert kernel_of("magiclens.optics.made_up")(2.0) == 4.0  # type: ignore[operator]
        observer.started("matcher exhaustive", 64)
        assert observer._child.poll() is None  # type: ignore[attr-defined]
    assert watching.notices == ["compiling kernels, once: the next run starts at once"]
    assert watching.names == ["matcher exhaustive"]


def test_kernels_of_others_are_not_announced(spec: Path) -> None:
    watching = Watching()
    with compiling_ahead(spec, (), watching):
        assert kernel_of("somebody.elses")(2.0) == 4.0  # type: ignore[operator]
    assert watching.notices == []


def test_outside_a_run_nothing_listens(spec: Path) -> None:
    watching = Watching()
    with compiling_ahead(spec, (), watching):
        pass
    kernel_of("magiclens.optics.made_up")(2.0)  # type: ignore[operator]
    assert watching.notices == []


def test_the_small_lens_has_the_facets_of_the_large_one(spec: Path) -> None:
    plan = load_plan(spec)
    small = small_scene(plan).lens
    assert (small.facets, small.pitch_mm, small.microfacets) == (2, plan.lens.pitch_mm, plan.lens.microfacets)


@pytest.mark.every_third
@pytest.mark.parametrize("part", ["match", "refine", "export", "render", "inspect", "analyse"])
def test_no_part_fails_on_the_small_lens(part: str, spec: Path) -> None:
    """A failure is not reported, so nobody would see that kernels are no longer compiled ahead."""
    plan = load_plan(spec)
    compilation._PARTS[part](plan, small_scene(plan))


def test_analyses_that_are_left_out_compile_nothing(spec: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They only trace; what rendering has compiled is enough for them."""
    for constant in ("RESOLUTION", "MAP_RESOLUTION"):
        monkeypatch.setattr(f"magiclens.analysis.tolerances.{constant}", 16)
    monkeypatch.setattr("magiclens.analysis.stable_zone.RESOLUTION", 16)
    plan = load_plan(spec)
    scene = small_scene(plan)
    compilation._PARTS["render"](plan, scene)
    before = compiled()
    assert before
    tolerances(scene, compilation._solid(scene))
    seen_from(scene, compilation._solid(scene), np.array([5.0, 0.0, 0.0]))
    assert compiled() == before


def compiled() -> set[tuple[str, str]]:
    """Kernels of magiclens that this process has ready, each with its arguments' types."""
    modules = [module for name, module in sys.modules.items() if name.startswith("magiclens.")]
    kernels = [thing for module in modules for thing in vars(module).values() if isinstance(thing, Dispatcher)]
    return {(str(kernel.py_func), str(types)) for kernel in kernels for types in kernel.signatures}


@pytest.mark.parametrize("text", compilation._SPECS)
def test_specs_that_need_all_kernels_are_right(text: str, tmp_path: Path) -> None:
    (tmp_path / "all.yaml").write_text(text, encoding="utf-8")
    assert load_plan(tmp_path / "all.yaml").matcher.stage.type in ("exhaustive", "multi-view", "dart-throwing")


@pytest.mark.tools
def test_a_child_whose_parent_is_killed_ends_by_itself(spec: Path, tmp_path: Path) -> None:
    parent = f"""
import os
from pathlib import Path
from magiclens.running.compilation import _start_child
print(_start_child([Path({str(spec)!r})], (), ("match",)).pid, flush=True)
input()
"""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}  # all of them have to be compiled: it takes long
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", parent], stdin=pipe, stdout=pipe, env=env) as started:
        assert started.stdout
        child = int(started.stdout.readline())
        time.sleep(2)
        started.kill()
    limit = time.monotonic() + 60
    while Path(f"/proc/{child}/stat").exists() and Path(f"/proc/{child}/stat").read_text().split()[2] != "Z":
        assert time.monotonic() < limit
        time.sleep(0.05)


def test_the_child_names_the_parts_that_are_done(spec: Path) -> None:
    command = [sys.executable, "-m", "magiclens.running.compilation", str(os.getpid()), "inspect,match", str(spec)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ.copy())
    assert done.stdout.split() == ["inspect", "match"]
