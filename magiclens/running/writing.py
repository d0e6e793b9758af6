"""Writes what a run has made into its folder."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from magiclens.config.fields import Inputs
from magiclens.contract.artifacts import FloatArray, Scene, Transport
from magiclens.running.folder import save_transport
from magiclens.running.manifest import render_path, target_path


def copy_inputs(inputs: Inputs, folder: Path) -> None:
    """Copy the files that the spec uses, so that the run folder's ``spec.yaml`` runs anywhere."""
    for path, kept in inputs.items():
        (folder / kept).parent.mkdir(exist_ok=True)
        shutil.copyfile(path, folder / kept)


def write_scene_pictures(scene: Scene, folder: Path) -> None:
    """Write the sources, true to scale for printing, and the targets; equal ones are one file."""
    from magiclens.images.files import write_png

    write_sources(scene, folder)
    (folder / "targets").mkdir()
    for path, picture in {target_path(view): view.target for view in scene.views}.items():
        write_png(folder / path, picture)


def write_sources(scene: Scene, folder: Path, name: str = "sources") -> None:
    """Write every source once, with its physical size, into the sub-folder ``name``."""
    from magiclens.images.files import write_png

    (folder / name).mkdir()
    for source, picture in {view.source_name: view.source for view in scene.views}.items():
        write_png(folder / name / f"{source}.png", picture, len(picture) / scene.lens.source_size_mm)


def save_transports(scene: Scene, transports: Sequence[Transport], folder: Path) -> None:
    """Write one matrix for all views that are alike, so that other pictures are encoded without tracing.

    Args:
        scene: The lens and its views.
        transports: One matrix per view.
        folder: The run folder.
    """
    from magiclens.rendering.transports import traced_view

    for view, matrix in zip(scene.views, transports, strict=True):
        if traced_view(scene, view) is view:
            save_transport(matrix, view, folder)


def write_renders(renderer: str, scene: Scene, pictures: Sequence[FloatArray], folder: Path) -> None:
    """Write what a renderer saw.

    Args:
        renderer: The renderer's type.
        scene: The lens and its views.
        pictures: One picture (R, R, C), linear light, per view.
        folder: The run folder.
    """
    from magiclens.images.files import write_png

    for view, picture in zip(scene.views, pictures, strict=True):
        path = folder / render_path(renderer, view)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, picture)


def write_figure_pictures(pictures: Mapping[str, FloatArray], folder: Path) -> None:
    """Write pictures (R, R, C), linear light, that an analysis has found, as ``figures/<name>.png``."""
    from magiclens.images.files import write_png

    for name, picture in pictures.items():
        (folder / "figures").mkdir(exist_ok=True)
        write_png(folder / "figures" / f"{name}.png", picture)


def write_animations(scene: Scene, fps: float, seen: Sequence[FloatArray], folder: Path) -> None:
    """Write the sources one after the other, and the picture that the eye sees of each, as GIF and MP4.

    Args:
        scene: The lens; its views are the frames.
        fps: Frames per second.
        seen: One picture (R, R, C), linear light, per view.
        folder: The run folder.
    """
    from magiclens.images import resize
    from magiclens.images.movies import write_gif, write_mp4

    (folder / "animations").mkdir()
    side = len(seen[0])
    for name, frames in (("sources", [resize(view.source, (side, side)) for view in scene.views]), ("seen", seen)):
        write_gif(folder / "animations" / f"{name}.gif", frames, fps)
        write_mp4(folder / "animations" / f"{name}.mp4", frames, fps)
