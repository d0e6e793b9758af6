"""Compiles the kernels of a plan on two cores at the first run after an installation, and says so.

numba compiles a kernel when it is called for the first time, and keeps it on disk. In a new installation that is most
of the time of a run. So a child process compiles what later steps need while this process compiles what the first ones
need: it puts a very small lens through the same stages. Nothing depends on the child: whatever it has not compiled is
compiled when it is called.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from magiclens.contract.artifacts import Assignment, Candidates, HeightField, Scene, Solid
from magiclens.contract.result import RunResult
from magiclens.plan.compile import Plan, load_plan
from magiclens.running.design import generators
from magiclens.running.manifest import REFERENCE_RENDERER
from magiclens.running.observers import Observer

if TYPE_CHECKING:
    from numba.core.event import Event

_NOTICE = "compiling kernels, once: the next run starts at once"
_EYES = "{target: {art: heart}, eye: {tilt: 9deg}}, {target: {art: star}, eye: {tilt: 9deg, azimuth: 180deg}}"
_SPECS = tuple(
    f"{scenario}\npipeline: {{renderers: [{{type: tracer, resolution: 64}}]}}"
    for scenario in (
        "scenario: {type: single, source: {type: circles}, target: {art: heart}}",
        f"scenario: {{type: multi-view, source: {{type: circles, size: 110mm}}, views: [{_EYES}]}}",
        "scenario: {type: universal-animation, frames: {art: worm, length: 1}}",
        "scenario: {type: single, source: {type: circles}, target: {art: heart}}\nfabrication: {machine: sla}",
    )
)
"""Specs for all kernels that a design may need: every matcher, and a printer's lens. Pictures take little time."""
_TRACING = ("stable-zone", "tolerances")
"""Analyses that trace many pictures and score them, for which ``render`` has compiled what they need."""
_SIDE = 2
"""Facets along one side of the small lens: some kernels run only between facets."""


@contextmanager
def compiling_ahead(spec: Path, overrides: Sequence[str], observer: Observer) -> Iterator[Observer]:
    """Compile in a child process what later steps need while the ``with`` block runs a spec.

    Nothing is started unless some kernel has to be compiled.

    Args:
        spec: The spec file.
        overrides: ``key.path=value`` texts that are laid over it.
        observer: Is told that kernels are compiled.

    Yields:
        The observer to run with; it waits for the child before steps whose kernels the child compiles.
    """
    from numba.core.event import install_listener

    ahead = _CompilationAhead(spec, overrides, observer)
    try:
        with install_listener("numba:compile", _listener(ahead.start_child)):
            yield ahead
    finally:
        ahead.end()


def compile_all_kernels() -> None:
    """Compile the kernels that the built-in stages of a design need, in two processes side by side."""
    with TemporaryDirectory() as folder:
        specs = [Path(folder, f"{k}.yaml") for k in range(len(_SPECS))]
        for spec, text in zip(specs, _SPECS, strict=True):
            spec.write_text(text, encoding="utf-8")
        for child in [_start_child(specs, (), parts) for parts in (_EARLY, _LATE)]:
            child.communicate()


class _CompilationAhead(Observer):
    """Passes everything on to another observer; starts the child at the first compilation, and waits for it."""

    def __init__(self, spec: Path, overrides: Sequence[str], observer: Observer):
        self._observer = observer
        self._start = partial(_start_child, [spec], overrides, _LATE)
        self._child: subprocess.Popen[str] | None = None
        self._done: set[str] = set()

    def started(self, name: str, facets: int) -> None:
        """Wait until the child has compiled what this piece of work needs."""
        self._observer.started(name, facets)
        part = next((part for start, part in _NEEDS.items() if name.startswith(start)), _LATE[-1])
        if part in _LATE:
            self._wait_for("refine" if name.endswith("refinement") else part)

    def progressed(self, name: str, fraction: float) -> None:
        """Pass it on."""
        self._observer.progressed(name, fraction)

    def finished(self, name: str, seconds: float) -> None:
        """Pass it on."""
        self._observer.finished(name, seconds)

    def reused(self, name: str) -> None:
        """Pass it on."""
        self._observer.reused(name)

    def notice(self, text: str) -> None:
        """Pass it on."""
        self._observer.notice(text)

    def stopped(self) -> None:
        """Pass it on."""
        self._observer.stopped()

    def start_child(self) -> None:
        """Start the child, once."""
        if self._child is None:
            self._observer.notice(_NOTICE)
            self._child = self._start()

    def _wait_for(self, part: str) -> None:
        """Wait until the child has compiled a part, or has ended."""
        if self._child and self._child.stdout:
            while part not in self._done:
                # an empty line is the end of the output: the child has ended, and the run compiles for itself
                line = self._child.stdout.readline().strip()
                self._done |= {line} if line else set(_LATE)

    def end(self) -> None:
        """End the child, which a run that failed no longer needs."""
        if self._child:
            self._child.kill()
            self._child.communicate()


def _listener(compiling: Callable[[], None]) -> Any:
    """A numba listener that calls a function whenever one of our kernels is about to be compiled."""
    from numba.core.event import Listener

    class KernelListener(Listener):
        def on_start(self, event: Event) -> None:
            if event.data["dispatcher"].py_func.__module__.startswith("magiclens."):
                compiling()

        def on_end(self, event: Event) -> None:
            pass

    return KernelListener()


def _start_child(specs: Sequence[Path], overrides: Sequence[str], parts: Sequence[str]) -> subprocess.Popen[str]:
    """A process that does ``compile_parts`` for specs; its standard output names the parts that are done."""
    what = [str(os.getpid()), ",".join(parts), os.pathsep.join(map(str, specs)), *overrides]
    # -P: what lies in the folder that the user happens to be in, maybe another magiclens, is not what runs
    command = [sys.executable, "-P", "-m", __name__, *what]
    # errors are of no interest: what the child has not compiled, the run compiles, and reports what is wrong
    nothing = subprocess.DEVNULL
    # numba words an error for every function that does not fit a call's types, and colours it
    environment = {**os.environ, "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1"}
    return subprocess.Popen(command, stdin=nothing, stdout=subprocess.PIPE, stderr=nothing, text=True, env=environment)


def compile_parts(parts: Sequence[str], spec: Path, overrides: Sequence[str] = ()) -> None:
    """Compile the kernels of some parts of a run, and print the name of each part that is done.

    Args:
        parts: Keys of ``_PARTS``.
        spec: The spec file.
        overrides: ``key.path=value`` texts that are laid over it.
    """
    plan = load_plan(spec, overrides)
    scene = small_scene(plan)
    for part in parts:
        # a part that fails on so small a lens is compiled by the run, which reports what is wrong, if anything is
        with suppress(Exception):
            _PARTS[part](plan, scene)
        print(part, flush=True)


def small_scene(plan: Plan) -> Scene:
    """The plan's scene with a lens of 2 x 2 of its facets, as the medium shows it."""
    lens = plan.lens
    small = replace(lens, facets=_SIDE, size_mm=_SIDE * lens.pitch_mm)
    return plan.on_medium(replace(plan.scene(), lens=small))


def _flat(scene: Scene) -> HeightField:
    m = scene.lens.microfacets
    return HeightField(scene.lens, np.zeros((_SIDE, _SIDE, m + 1, m + 1)), scene.cut_eye_mm)


def _solid(scene: Scene) -> Solid:
    from magiclens.geometry.solid import solid_from_heights

    return solid_from_heights(_flat(scene))


def _candidates() -> Candidates:
    shape = (_SIDE, _SIDE, 1)
    maps = np.tile(np.array([1.0, 0.0, 1.0], np.float32), (*shape, 1))
    return Candidates(np.zeros((*shape, 2), np.float32), maps, np.zeros(shape, np.float32))


def _match(plan: Plan, scene: Scene) -> None:
    plan.matcher.stage.match(scene, generators(plan.spec.seed)["matcher"])


def _anneal(plan: Plan, scene: Scene) -> None:
    assignment = plan.annealer.stage.anneal(scene, _candidates(), generators(plan.spec.seed)["annealer"])
    plan.integrator.stage.integrate(scene, assignment)


def _refine(plan: Plan, scene: Scene) -> None:
    if plan.matcher.stage.uses_pictures:
        plan.integrator.stage.refine(scene, _flat(scene))


def _export(plan: Plan, scene: Scene) -> None:
    with TemporaryDirectory() as folder:
        for exporter in plan.exporters:
            if type(exporter.stage).__module__.startswith("magiclens."):  # others may do more than write files
                with suppress(Exception):
                    exporter.stage.export(scene, _solid(scene), Path(folder, f"lens{exporter.stage.suffix}"))


def _render(plan: Plan, scene: Scene) -> None:
    from magiclens.images.score import score
    from magiclens.rendering.poses import Pose, PosedLens

    view = scene.views[0]
    score(PosedLens(_solid(scene), scene.lens, 16, 1).picture(view, Pose()), view.target)
    for renderer in plan.renderers:
        if renderer.stage.type == REFERENCE_RENDERER:
            renderer.stage.render(scene, _solid(scene))
    if plan.encoder:
        from magiclens.rendering.transports import transports

        transports(scene, _solid(scene))


def _analyse(plan: Plan, scene: Scene) -> None:
    candidates, solid = _candidates(), _solid(scene)
    result = RunResult(
        given=scene, painted=scene, scene=scene, candidates=candidates,
        assignment=Assignment.pick(candidates, np.zeros((_SIDE, _SIDE), np.int64)), height_field=_flat(scene),
        unfinished=solid, solid=solid, renders={}, manifest={"metrics": {}},
    )  # fmt: skip
    for planned in plan.analyses:
        if planned.analysis.name in _TRACING:
            continue
        # each for itself: one that fails on so small a lens must not keep the next from being compiled
        with suppress(Exception):
            findings = planned.analysis.compute(plan, result)
            planned.analysis.figures(result, findings)


def _inspect(plan: Plan, scene: Scene) -> None:
    from magiclens.preflight.picture import light_in_pixels
    from magiclens.preflight.triangles import trace_triangles

    solid, view = _solid(scene), scene.views[0]
    traced = trace_triangles(solid.vertices.astype(np.float32)[solid.faces], scene.lens, view.eye_mm)
    light_in_pixels(traced, scene.lens, view)


_PARTS: dict[str, Callable[[Plan, Scene], None]] = {
    "match": _match, "anneal": _anneal, "refine": _refine, "export": _export, "render": _render,
    "analyse": _analyse, "inspect": _inspect,
}  # fmt: skip
_EARLY = ("match", "anneal")
"""What a run compiles itself, since it needs it first."""
_LATE = ("refine", "export", "render", "inspect", "analyse")
"""What the child compiles, in the order in which a run needs it, the longest first."""
_NEEDS = {
    "pictures": "match", "matcher": "match", "annealer": "anneal", "integrator": "anneal", "meshing": "export",
    "finisher": "export", "exporter": "export", "renderer": "render", "contact-sheet": "render",
    **dict.fromkeys(_TRACING, "render"), "preflight": "inspect",
}  # fmt: skip
"""The part that a piece of work needs, by how its name begins; others need them all."""


def _end_with(parent: int) -> None:
    """End this process soon after the one that started it, which may have been killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    _end_with(int(sys.argv[1]))
    gc.disable()  # what it would find is free before long anyway, and looking takes a second and more
    for path in sys.argv[3].split(os.pathsep):
        compile_parts(sys.argv[2].split(","), Path(path), sys.argv[4:])
    gc.freeze()  # the process ends, and with it its memory: otherwise Python would look through all objects first
