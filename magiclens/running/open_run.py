"""Finished run folders opened again: other pictures are encoded for the lens or seen through it (sections 5 and 6)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magiclens.config.fabrication import listed_machine
from magiclens.config.fields import Inputs
from magiclens.config.suggest import unknown
from magiclens.contract.artifacts import FloatArray, HeightField, Scene, Solid, Transport, View
from magiclens.contract.errors import InputError
from magiclens.plan.blame import blaming
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.registry import Registry
from magiclens.profiles.machines import Machine
from magiclens.profiles.materials import materials
from magiclens.running.folder import HEIGHTS
from magiclens.running.manifest import refresh_manifest, source_path
from magiclens.running.run_files import RunFiles, verified

if TYPE_CHECKING:
    from magiclens.preflight.finding import Preflight
    from magiclens.rendering.poses import Pose, PosedLens

_FRAMES_PER_BATCH = 4
"""Frames that are encoded together; more would hold more pictures in memory at once."""
_POSED_PX, _POSED_SAMPLES = 256, 3
"""Pixels along the side of a posed picture, and samples along the side of each."""
_ROUGH = "as-made-rough"
"""How names of pictures begin that are traced through rough surfaces."""
_PREFLIGHT = ("preflight.html", "preflight.json")
"""Files of preflight."""
_PICTURES = ("sources/", "targets/", "renders/", "figures/")
"""Folders of pictures, which preflight compares and shows."""


@dataclass(frozen=True)
class OpenRun:
    """A finished run folder, with the plan and the scene it was made from.

    Attributes:
        files: The run folder, whose files are checked when they are read.
        plan: The plan of its spec.
        scene: The scene with the sources that the spec gives, not those that an encoder made of them (see
            ``printed_scene``).
        maker: The machine that makes the lens in place of that of the spec; None for that of the spec, if it names one.
    """

    files: RunFiles
    plan: Plan
    scene: Scene
    maker: Machine | None = None

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.files.path

    @property
    def printed_scene(self) -> Scene:
        """The scene with the sources of the run folder, as they are printed: those of an encoder, if there is one."""
        from magiclens.images import resize
        from magiclens.images.files import read_image

        def source(view: View) -> FloatArray:
            picture = resize(read_image(self.files.file(source_path(view))), view.source.shape[:2])
            # a source of three channels that are equal is stored, and read back, as grey
            return np.ascontiguousarray(np.broadcast_to(picture, view.source.shape), np.float32)

        return replace(self.scene, views=tuple(replace(view, source=source(view)) for view in self.scene.views))

    @cached_property
    def solid(self) -> Solid:
        """The finished lens, from its stored heights."""
        from magiclens.geometry.solid import solid_from_heights

        return solid_from_heights(self.top)

    @cached_property
    def top(self) -> HeightField:
        """The top as it was designed, from its stored heights."""
        return HeightField(self.plan.lens, self.files.heights(self.plan.lens), self.scene.cut_eye_mm)

    @cached_property
    def top_as_made(self) -> HeightField:
        """The top at the vertices of its grid: as its printer makes it, or as it was designed if none is named."""
        from magiclens.geometry.columns import sampled_top

        if self._body is not self.solid:
            return sampled_top(self._body, self.plan.lens)
        return self.top

    def view(self, name: str | None = None) -> View:
        """The view of that name, the first one by default. Raises InputError if there is no such view."""
        names = [view.name for view in self.scene.views]
        if name is not None and name not in names:
            raise InputError(unknown("view", name, names), "--view")
        return self.scene.views[names.index(name) if name else 0]

    def transport(self, name: str | None = None, pose: Pose | None = None) -> Transport:
        """The matrix from a source to the picture that a view's eye sees of it.

        It is read from the run folder, or traced when it is first asked for. Raises InputError like ``view``.

        Args:
            name: The view, the first one by default.
            pose: How far sheet, lens and eye are from where they should be; None for nowhere else.
        """
        from magiclens.rendering.transports import posed_transport, traced_view, transports

        view = self.view(name)
        if pose is not None:
            return posed_transport(self._posed(_POSED_PX, _POSED_SAMPLES), self.scene.lens, view, pose)
        first = traced_view(self.scene, view)
        if first.name not in self._transports:
            kept = None if self.maker else self.files.transport(first)
            self._transports[first.name] = kept or transports(replace(self.scene, views=(first,)), self._body)[0]
        return self._transports[first.name].turned(view.quarter_turns - first.quarter_turns)

    @cached_property
    def _body(self) -> Solid:
        from magiclens.simulation.as_made import body_made_by, body_of

        if self.maker:
            return body_made_by(self.solid, self.maker)
        return body_of(self.solid, self.plan.fabrication.machine if self.plan.fabrication else None)

    def made_by(self, name: str) -> OpenRun:
        """The same mesh as a listed machine makes it, of the material that is usual for that machine.

        Raises:
            InputError: There is no such machine; the nearest name is proposed.
        """
        profile = listed_machine(name, "--machine")
        material = profile.lens.get("material")
        ior = materials()[material].ior if material else self.scene.lens.ior
        scene = replace(self.scene, lens=replace(self.scene.lens, ior=ior))
        return replace(self, scene=scene, maker=profile.machine())

    @cached_property
    def _transports(self) -> dict[str, Transport]:
        return {}

    def encode(
        self,
        frames: Iterable[FloatArray],
        name: str | None = None,
        shown: Callable[[float], object] = lambda share: None,
    ) -> Iterator[FloatArray]:
        """Sources that show these frames to a view's eye.

        Args:
            frames: (h, w, C) linear light, C = 1 or 3; each is padded to a square with white paper.
            name: The view, the first one by default.
            shown: Is told of every source how much of its frame shows without the lens, see ``shown_in_sheet``.

        Returns:
            One source (H, W, C) float32 per frame, linear light.

        Raises:
            InputError: The lens has no encoder, since it was designed for the sources it has, or no such view.
        """
        from magiclens.analysis.secrecy import shown_in_sheet

        step, view = self.plan.encoder, self.view(name)
        if step is None:
            raise InputError("this lens was designed for its source and has no encoder; use a universal lens")
        # the seed of the spec, so that the same frames give the same sources whenever they are encoded
        transport, rng = self.transport(name), np.random.default_rng(self.plan.spec.seed)
        waiting = iter(frames)
        while batch := list(islice(waiting, _FRAMES_PER_BATCH)):
            channels = max(view.source.shape[-1], *(frame.shape[-1] for frame in batch), 1)
            views = tuple(_with_target(view, frame, channels, str(k)) for k, frame in enumerate(batch))
            scene = replace(self.scene, views=views)
            with blaming(str(step)):
                painted = step.stage.encode(scene, [transport] * len(views), rng)
            for each in painted.views:
                shown(shown_in_sheet(each.source, each.target, self.plan.lens))
                yield each.source

    def decode(self, sources: Iterable[FloatArray], name: str | None = None) -> Iterator[FloatArray]:
        """Pictures that a view's eye sees of these sources.

        Args:
            sources: (h, w, C) linear light, C = 1 or 3; each is padded to a square with white paper.
            name: The view, the first one by default.

        Returns:
            One picture (R, R, C) per source, linear light.

        Raises:
            InputError: There is no such view.
        """
        from magiclens.images import padded_to_square, resize

        transport = self.transport(name)
        medium = self.plan.spec.medium
        fitting = (resize(padded_to_square(source), transport.source_shape) for source in sources)
        return (transport.see(medium.shown(source) if medium else source) for source in fitting)

    def seen(
        self,
        pose: Pose | None = None,
        name: str | None = None,
        resolution: int = _POSED_PX,
        samples: int = _POSED_SAMPLES,
    ) -> FloatArray:
        """What a view's eye sees when sheet, lens and eye do not lie as designed, through the lens as it is made.

        Args:
            pose: How far they are from where they should be; None for nowhere else.
            name: The view, the first one by default.
            resolution: Pixels along a side of the picture, R.
            samples: Samples along a side of each pixel.

        Returns:
            (R, R, C) float32, linear light.

        Raises:
            InputError: There is no such view.
        """
        from magiclens.rendering.poses import Pose

        place = self.scene.views.index(self.view(name))
        return self._posed(resolution, samples).picture(self.lit_scene.views[place], pose or Pose())

    def _posed(self, resolution: int, samples: int) -> PosedLens:
        """The lens to be seen in any pose, which is kept: a sheet that is moved below it needs no other rays."""
        from magiclens.rendering.poses import PosedLens

        kept = (resolution, samples)
        if kept not in self._posed_lenses:
            self._posed_lenses[kept] = PosedLens(self._body, self.scene.lens, resolution, samples)
        return self._posed_lenses[kept]

    @cached_property
    def _posed_lenses(self) -> dict[tuple[int, int], PosedLens]:
        return {}

    @cached_property
    def lit_scene(self) -> Scene:
        """The scene with the light that its printed sheets reflect."""
        return self.plan.on_medium(self.printed_scene)


def open_run(folder: str | Path, registry: Registry | None = None) -> OpenRun:
    """Open a finished run folder.

    Raises:
        InputError: It is no run folder; or a file that is read has been damaged or changed since the run.
    """
    files = verified(folder)
    plan = _plan_of(files, registry)
    return OpenRun(files, plan, plan.scene())


def check_run_folder(folder: str | Path, registry: Registry | None = None) -> tuple[Preflight, str]:
    """Check the files of a finished run folder again, and write its preflight page.

    If its printer can be simulated, the lens is also path-traced as it will be printed, with its rough surface, into
    ``figures/as-made-rough-<view>.png``.

    Returns:
        The findings, and the same as a table for a terminal.

    Raises:
        InputError: The folder is no run folder, or has no mesh.
    """
    from magiclens.preflight.checks import run_preflight
    from magiclens.preflight.mesh_file import mesh_files
    from magiclens.preflight.page import preflight_text, write_preflight
    from magiclens.simulation.as_made import rough_pictures, write_pictures

    path = Path(folder)
    files = verified(path)
    plan = _plan_of(files, registry)
    for name in files.listed:
        if name.startswith(_PICTURES):
            files.file(name)
    if plan.fabrication and files.has(HEIGHTS):
        lens = OpenRun(files, plan, plan.scene())
        pictures = rough_pictures(plan.fabrication.machine, lens.lit_scene, lens.solid)
        write_pictures(pictures, lens.scene.views[: len(pictures)], path, _ROUGH)
    found = run_preflight(path, files.manifest, plan)
    write_preflight(found, path)
    meshes = (mesh.name for mesh in mesh_files(path))  # which may have been repaired since
    refresh_manifest(path, *meshes, *_PREFLIGHT, *(f"figures/{_ROUGH}-{view.name}.png" for view in plan.shots()))
    return found, preflight_text(found)


def _plan_of(files: RunFiles, registry: Registry | None) -> Plan:
    """The plan that the run was made by, whose files are all copies in the run folder."""
    plan, inputs = load_plan(files.file("spec.yaml"), (), registry), Inputs()
    plan.resolved(inputs)
    for path in inputs:
        if not path.resolve().is_relative_to(files.path.resolve()):
            raise InputError(f"the spec names '{path}', which is not in the run folder", str(files.path / "spec.yaml"))
        files.file(path.resolve().relative_to(files.path.resolve()).as_posix())
    return plan


def _with_target(view: View, frame: FloatArray, channels: int, name: str) -> View:
    """The view with another target, and with a source that no other view shares: each frame gets a source of its own.

    Args:
        view: The view of the lens.
        frame: (h, w, C) linear light, padded to a square with white paper.
        channels: Number of channels that source and target get.
        name: Name of the source and of the target.
    """
    from magiclens.images import padded_to_square

    source, target = (
        np.array(np.broadcast_to(picture, (*picture.shape[:2], channels)), np.float32)
        for picture in (view.source, padded_to_square(frame))
    )
    return replace(view, source=source, target=target, source_name=name, target_name=name)
