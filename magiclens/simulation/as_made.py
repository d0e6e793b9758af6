"""The lens as its machine makes it, compared with the lens as designed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray, Scene, Solid, View
from magiclens.contract.errors import InputError
from magiclens.images import score, write_png
from magiclens.images.score import best_exposure_psnr_db
from magiclens.profiles.machines import Machine, Mill, Printer
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.rendering.tracer import Tracer
from magiclens.simulation.as_milled import as_milled, seen_as_milled
from magiclens.simulation.as_printed import as_printed


@dataclass(frozen=True)
class AsMade:
    """What the lens shows as made.

    pictures: per view (R, R, C) float32, linear light, world frame. psnr_db: their mean PSNR against the targets.
    loss_db: the mean PSNR of the lens as designed, minus ``psnr_db``.
    """

    pictures: Sequence[FloatArray]
    psnr_db: float
    loss_db: float


def as_made(machine: Machine, scene: Scene, solid: Solid) -> AsMade | None:
    """Trace the lens as made, and compare it with the lens as designed; None if it is too large, or has no grid.

    The loss is what limits of the design cannot prevent: stairs, spreading, corners that no cutter reaches, polishing.
    What those limits cost is not in it, since a lens without them was never designed.
    """
    if solid.grid is None:
        return None
    if isinstance(machine, Mill):
        pictures = seen_as_milled(scene, solid, machine)
    else:
        assert isinstance(machine, Printer)
        pictures = Tracer().render(scene, as_printed(solid, machine))
    if pictures is None:
        return None
    shown_db = _psnr_db(pictures, scene)
    return AsMade(pictures, shown_db, _psnr_db(Tracer().render(scene, solid), scene) - shown_db)


def body_of(solid: Solid, machine: Machine | None) -> Solid:
    """The body that is looked through: as a printer makes a solid with a grid, otherwise as it was designed.

    Sources are painted for this body, so that they make up for what printing does to it.
    """
    return as_printed(solid, machine) if isinstance(machine, Printer) and solid.grid else solid


def body_made_by(solid: Solid, machine: Machine) -> Solid:
    """The body that any machine makes of a solid with a grid: what a printer builds, or what a cutter leaves standing.

    Raises:
        InputError: The solid is too large for the simulation of the mill.
    """
    body = _body(solid, machine)
    if body is None:
        raise InputError("this lens is too large for the simulation of a mill")
    return body


def _body(solid: Solid, machine: Machine) -> Solid | None:
    return as_milled(solid, machine) if isinstance(machine, Mill) else body_of(solid, machine)


def rough_pictures(machine: Machine, scene: Scene, solid: Solid) -> list[FloatArray]:
    """The same path-traced by Mitsuba, with the roughness of the machine's surface; nothing if it is not simulated."""
    if solid.grid is None:
        return []
    made = _body(solid, machine)
    return [] if made is None else Mitsuba(roughness=machine.roughness).render(scene, made)


def write_pictures(pictures: Sequence[FloatArray], views: Sequence[View], folder: Path, name: str) -> None:
    """Write ``figures/<name>-<view>.png``, each at its best exposure."""
    (folder / "figures").mkdir(exist_ok=True)
    for picture, view in zip(exposed(pictures, views), views, strict=True):
        write_png(folder / "figures" / f"{name}-{view.name}.png", picture)


def exposed(pictures: Sequence[FloatArray], views: Sequence[View]) -> list[FloatArray]:
    """The pictures (R, R, C) of the views at the exposure that fits their targets best, 0 to 1, linear light."""
    pairs = zip(pictures, views, strict=True)
    return [np.clip(picture * score(picture, view.target).gain, 0, 1) for picture, view in pairs]


def _psnr_db(pictures: Sequence[FloatArray], scene: Scene) -> float:
    pairs = zip(pictures, scene.views, strict=True)
    return float(np.mean([best_exposure_psnr_db(picture, view.target) for picture, view in pairs]))
