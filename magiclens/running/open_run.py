"""A finished lens put to use again: other pictures through the same glass (sections 5 and 6)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magiclens.config.suggest import unknown
from magiclens.contract.artifacts import FloatArray, HeightField, Scene, Solid, Transport, View
from magiclens.contract.errors import InputError
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.registry import Registry, blaming
from magiclens.running.folder import HEIGHTS, MANIFEST, load_heights, load_transport
from magiclens.running.manifest import refresh_manifest, source_path

if TYPE_CHECKING:
    from magiclens.preflight.inspect import Preflight

BATCH = 4
"""Frames that are encoded together."""


@dataclass(frozen=True)
class OpenRun:
    """A run folder whose lens can be looked through again. ``scene`` has the sources that the spec gave."""

    folder: Path
    plan: Plan
    scene: Scene

    @property
    def printed_scene(self) -> Scene:
        """The scene with the sources that the run folder holds: those of an encoder, if there is one."""
        from magiclens.images import resize
        from magiclens.images.files import read_image

        def source(view: View) -> FloatArray:
            picture = resize(read_image(self.folder / source_path(view)), view.source.shape[:2])
            return np.ascontiguousarray(np.broadcast_to(picture, view.source.shape), np.float32)

        return replace(self.scene, views=tuple(replace(view, source=source(view)) for view in self.scene.views))

    @cached_property
    def solid(self) -> Solid:
        """The finished lens, from its stored heights."""
        from magiclens.geometry.solid import solid_from_heights

        lens = self.plan.lens
        eye = None if lens.cells == "vertical" else self.scene.reference_eye_mm
        return solid_from_heights(HeightField(lens, load_heights(self.folder), eye))

    def view(self, name: str | None = None) -> View:
        """A view by its name, the first by default. Raises InputError if there is no such view."""
        names = [view.name for view in self.scene.views]
        if name is not None and name not in names:
            raise InputError(unknown("view", name, names), "--view")
        return self.scene.views[names.index(name) if name else 0]

    def transport(self, name: str | None = None) -> Transport:
        """The matrix from a source to what a view's eye sees: the one that the run kept, or traced once.

        Raises InputError, see ``view``.
        """
        from magiclens.rendering.traced import alike, transports

        view = self.view(name)
        first = alike(self.scene, view)
        if first.name not in self._transports:
            kept = load_transport(first, self.folder)
            self._transports[first.name] = kept or transports(replace(self.scene, views=(first,)), self.solid)[0]
        return self._transports[first.name].turned(view.quarter_turns - first.quarter_turns)

    @cached_property
    def _transports(self) -> dict[str, Transport]:
        return {}

    def encode(self, frames: Iterable[FloatArray], name: str | None = None) -> Iterator[FloatArray]:
        """One source (H, W, C) per frame (h, w, C), linear light, that shows it to the view's eye.

        Raises InputError if the lens has no encoder: its sources are not to be edited.
        """
        step, view = self.plan.encoder, self.view(name)
        if step is None:
            raise InputError("this lens was designed for its source and has no encoder; use a universal lens")
        transport, rng = self.transport(name), np.random.default_rng(self.plan.spec.seed)
        waiting = iter(frames)
        while batch := list(islice(waiting, BATCH)):
            channels = max(view.source.shape[-1], *(frame.shape[-1] for frame in batch), 1)
            views = tuple(_showing(view, frame, channels, str(k)) for k, frame in enumerate(batch))
            scene = replace(self.scene, views=views)
            with blaming(str(step)):
                painted = step.stage.encode(scene, [transport] * len(views), rng)
            yield from (v.source for v in painted.views)

    def decode(self, sources: Iterable[FloatArray], name: str | None = None) -> Iterator[FloatArray]:
        """What the view's eye sees, (R, R, C) linear light, of each source (h, w, C)."""
        from magiclens.images import resize, square

        transport = self.transport(name)
        medium = self.plan.spec.medium
        fitting = (resize(square(source), transport.source_shape) for source in sources)
        return (transport.see(medium.shown(source) if medium else source) for source in fitting)


def open_run(folder: str | Path, registry: Registry | None = None) -> OpenRun:
    """Open a finished run folder. Raises InputError if it is none."""
    plan = _plan_of(Path(folder), registry)
    return OpenRun(Path(folder), plan, plan.scene())


def preflight(folder: str | Path, registry: Registry | None = None) -> tuple[Preflight, str]:
    """Check a finished run folder anew, by its files alone, and write its preflight page; a table too.

    If its printer can be simulated, the lens is path-traced as it will come out, rough surface included:
    ``figures/as-made-rough-<view>.png``. Raises InputError if it is no run folder, or has no mesh.
    """
    from magiclens.preflight.inspect import inspect
    from magiclens.preflight.page import table, write_preflight
    from magiclens.simulation.as_made import rough_pictures, write_pictures

    path = Path(folder)
    plan = _plan_of(path, registry)
    if plan.fabrication and (path / HEIGHTS).is_file():
        lens = OpenRun(path, plan, plan.scene())
        pictures = rough_pictures(plan.fabrication.machine, plan.on_medium(lens.printed_scene), lens.solid)
        write_pictures(pictures, lens.scene.views[: len(pictures)], path, "as-made-rough")
    found = inspect(path, json.loads((path / MANIFEST).read_text(encoding="utf-8")), plan)
    write_preflight(found, path)
    refresh_manifest(path)
    return found, table(found)


def _plan_of(path: Path, registry: Registry | None) -> Plan:
    if not (path / MANIFEST).is_file():
        raise InputError(f"'{path}' is not a run folder: it has no {MANIFEST}")
    return load_plan(path / "spec.yaml", (), registry)


def _showing(view: View, frame: FloatArray, channels: int, name: str) -> View:
    """The view with another target and a source of its own, both of so many channels."""
    from magiclens.images import square

    pictures = (
        np.array(np.broadcast_to(p, (*p.shape[:2], channels)), np.float32) for p in (view.source, square(frame))
    )
    source, target = pictures
    return replace(view, source=source, target=target, source_name=name, target_name=name)
