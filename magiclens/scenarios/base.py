"""What every scenario shares: from shots, worded by a scenario, to views with their pictures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from magiclens.config.model import Choice, SpecModel, Viewer
from magiclens.contract.artifacts import BoolArray, FloatArray, Lens, View, Viewpoint
from magiclens.scenarios.pictures import Art, Source, Target


@dataclass(frozen=True)
class Shot(Viewpoint):
    """One view before it has pictures: which source and target, seen from where, at which lens rotation.

    Shots of one scenario that have equal ``source_name`` share their source.
    """

    name: str
    source: Source
    target: Target
    eye_mm: FloatArray
    rotation_deg: float = 0.0
    source_name: str = "source"
    target_name: str = "target"

    def __str__(self) -> str:
        x, y, z = self.eye_mm
        seen = f"eye ({x:g}, {y:g}, {z:g}) mm, rotation {self.rotation_deg:g} deg"
        return f"{self.name}: {seen}, source {self.source}, target {self.target}"


class Scenario(SpecModel, ABC):
    """Base of all scenarios: the fields are the YAML keys, ``type`` is the name a spec picks it by."""

    type: ClassVar[str]

    @property
    def frames_per_second(self) -> float | None:
        """The speed at which the views are frames of an animation; None if they are none."""
        return None

    @abstractmethod
    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """Everything the lens must show, in the world frame."""

    def suited(self) -> dict[str, Choice]:
        """Stages, by kind, that this scenario needs or does best with; a spec may choose others."""
        return {}

    def reserved(self, lens: Lens, art: Art) -> BoolArray | None:
        """(H, W) bool: the source's region that is not to be used (see ``artifacts.Scene``), if there is one."""
        return None

    def fit(self, lens: Lens, viewer: Viewer) -> Lens:
        """The lens with the source size that the shots agree on, and a floor for all eyes. Raises ValueError if not."""
        shots = self.shots(lens, viewer)
        sizes = {lens.size_mm if s.source.size is None else s.source.size for s in shots}
        if len(sizes) > 1:
            raise ValueError(f"all sources need the same size, found {', '.join(f'{s:g}mm' for s in sorted(sizes))}")
        size = sizes.pop()
        if len({tuple(s.eye_in_lens_frame_mm.round(6)) for s in shots}) == 1:
            return replace(lens, source_size_mm=size)
        floor = min(size, lens.size_mm + lens.thickness_mm)
        return replace(lens, source_size_mm=size, bleed_mm=lens.pitch_mm / 2, floor_mm=floor)

    def compiled(self, lens: Lens, viewer: Viewer, art: Art) -> tuple[View, ...]:
        """The shots with their pictures; all have one channel if every picture is grey, else three."""
        return take(self.shots(lens, viewer), lens, art)


def toward(azimuth_deg: float) -> FloatArray:
    """(2,) unit vector, counter-clockwise from +x as the viewer sees it; quarter turns are exact."""
    azimuth = np.radians(azimuth_deg)
    return np.round([np.cos(azimuth), np.sin(azimuth)], 15) + 0.0


def take(shots: Sequence[Shot], lens: Lens, art: Art) -> tuple[View, ...]:
    """Give shots their pictures; a source that several share is made once."""
    sources = {s.source_name: s.source for s in shots}
    below = {name: source.raster(lens.source_size_mm, art) for name, source in sources.items()}
    above = [shot.target.raster(art) for shot in shots]
    channels = max(picture.shape[-1] for picture in (*below.values(), *above))
    below = {name: _with_channels(picture, channels) for name, picture in below.items()}
    return tuple(
        View(
            s.name,
            below[s.source_name],
            _with_channels(target, channels),
            s.eye_mm,
            s.rotation_deg,
            s.source_name,
            s.target_name,
        )
        for s, target in zip(shots, above, strict=True)
    )


def _with_channels(picture: FloatArray, channels: int) -> FloatArray:
    """(H, W, C) float32 with that many channels; grey is repeated."""
    rows, columns, _ = picture.shape
    return np.array(np.broadcast_to(picture, (rows, columns, channels)), np.float32)
