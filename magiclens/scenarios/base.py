"""The base of all scenarios: a scenario lists shots, and shots become views when their pictures are made."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from magiclens.config.model import Choice, SpecModel, Viewer
from magiclens.contract.artifacts import BoolArray, FloatArray, Lens, View, Viewpoint
from magiclens.scenarios.pictures import Art, Source, Target


@dataclass(frozen=True)
class Shot(Viewpoint):
    """A view whose pictures are not made yet: its source and target as the spec gives them, its eye and its rotation.

    eye_mm: (3,) float64, world frame. rotation_deg: counter-clockwise as the viewer sees it, in quarter turns. Shots
    of one scenario that have equal ``source_name`` share their source.
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
    """Base of all scenarios. Its fields are keys of the spec, ``type`` is the name by which a spec chooses it.

    ``repeatable`` is False for one whose pictures differ from time to time, as for stages. ``suitable_rematch`` is how
    many rounds of rematching it works best with; a spec may choose others.
    """

    type: ClassVar[str]
    repeatable: ClassVar[bool] = True
    suitable_rematch: ClassVar[int] = 0

    @property
    def frames_per_second(self) -> float | None:
        """The speed of the animation whose frames the views are; None if they are not frames of an animation."""
        return None

    @abstractmethod
    def shots(self, lens: Lens, viewer: Viewer) -> tuple[Shot, ...]:
        """All that the lens must show, in the world frame."""

    def suitable_stages(self) -> dict[str, Choice]:
        """Stages, by kind, that this scenario needs or works best with; a spec may choose others."""
        return {}

    def suitable_lens(self) -> dict[str, Any]:
        """Keys of ``lens``, as a spec writes them, with which this scenario works best.

        They hold if the spec writes none of them and names no machine.
        """
        return {}

    def reserved(self, lens: Lens, art: Art) -> BoolArray | None:
        """(H, W) bool, world frame: pixels of the source that must not be used (see ``artifacts.Scene``).

        None reserves nothing.
        """
        return None

    def fitted_lens(self, lens: Lens, viewer: Viewer) -> Lens:
        """The lens with the size of the shots' sources, and with a bottom that all eyes see the source through.

        Args:
            lens: The lens as the spec gives it.
            viewer: The viewer as the spec gives it.

        Raises:
            ValueError: The shots' sources differ in size.
        """
        shots = self.shots(lens, viewer)
        sizes = {lens.size_mm if s.source.size is None else s.source.size for s in shots}
        if len(sizes) > 1:
            raise ValueError(f"all sources need the same size, found {', '.join(f'{s:g}mm' for s in sorted(sizes))}")
        size = sizes.pop()
        if len({tuple(s.eye_in_lens_frame_mm.round(6)) for s in shots}) == 1:
            return replace(lens, source_size_mm=size)
        # half the thickness to each side is how far the rays of eyes tilted by 40 degrees run inside the slab
        floor = min(size, lens.size_mm + lens.thickness_mm)
        return replace(lens, source_size_mm=size, bleed_mm=lens.pitch_mm / 2, floor_mm=floor)

    def make_views(self, lens: Lens, viewer: Viewer, art: Art) -> tuple[View, ...]:
        """The shots with their pictures.

        Args:
            lens: What ``fitted_lens`` returned.
            viewer: The viewer as the spec gives it.
            art: Built-in pictures by name.

        Returns:
            Views in the world frame; all pictures have one channel if all are grey, else three.
        """
        return _views_of(self.shots(lens, viewer), lens, art)


def azimuth_direction(azimuth_deg: float) -> FloatArray:
    """(2,) unit vector, counter-clockwise from +x as the viewer sees it; quarter turns are exact."""
    azimuth = np.radians(azimuth_deg)
    return np.round([np.cos(azimuth), np.sin(azimuth)], 15) + 0.0


def _views_of(shots: Sequence[Shot], lens: Lens, art: Art) -> tuple[View, ...]:
    """The shots with their pictures; a source that several shots share is made once."""
    by_name = {s.source_name: s.source for s in shots}
    sources = {name: source.raster(lens.source_size_mm, art) for name, source in by_name.items()}
    targets = [shot.target.raster(art) for shot in shots]
    channels = max(picture.shape[-1] for picture in (*sources.values(), *targets))
    sources = {name: _with_channels(picture, channels) for name, picture in sources.items()}
    return tuple(
        View(
            s.name,
            sources[s.source_name],
            _with_channels(target, channels),
            s.eye_mm,
            s.rotation_deg,
            s.source_name,
            s.target_name,
        )
        for s, target in zip(shots, targets, strict=True)
    )


def _with_channels(picture: FloatArray, channels: int) -> FloatArray:
    """(H, W, C) float32 with this number of channels; a grey channel is repeated."""
    rows, columns, _ = picture.shape
    return np.array(np.broadcast_to(picture, (rows, columns, channels)), np.float32)
