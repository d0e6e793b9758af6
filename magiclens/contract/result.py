"""What a report is made from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from magiclens.contract.artifacts import Assignment, Candidates, FloatArray, HeightField, Scene, Solid


@dataclass(frozen=True)
class Zone:
    """How well lenses keep their picture while the eye moves away from the middle one of the eyes (section 7).

    Lenses are ``zone``, made for all eyes, and ``plain``, made in the same way for the middle one alone. distance_mm:
    from the eye to the reference plane. eyes_mm: how far from the middle the other eyes are, ascending, each distance
    once; the first is the rim of the inner cone. moves_mm: (M,) how far the eye is moved, from 0 on. psnr_db: by lens,
    (M, D), D directions evenly around. shown_mm: moves toward the upper right at which ``pictures``, by lens, were
    taken, each (R, R, C) float32, linear light.
    """

    distance_mm: float
    eyes_mm: Sequence[float]
    moves_mm: FloatArray
    psnr_db: Mapping[str, FloatArray]
    shown_mm: Sequence[float]
    pictures: Mapping[str, Sequence[FloatArray]]

    @property
    def metrics(self) -> dict[str, float]:
        """PSNR in the middle, and the worst within the inner cone."""
        inside = self.moves_mm <= self.eyes_mm[0] * (1 + 1e-9)
        return {
            f"{lens}_{which}_psnr_db": float(value)
            for lens, psnr in self.psnr_db.items()
            for which, value in (("centre", psnr[0, 0]), ("worst", psnr[inside].min()))
        }

    def degrees(self, move_mm: float) -> float:
        """The angle at the lens's centre by which the eye is moved."""
        return math.degrees(math.atan(move_mm / self.distance_mm))

    def move_mm(self, degrees: float) -> float:
        """How far the eye is moved by an angle at the lens's centre."""
        return self.distance_mm * math.tan(math.radians(degrees))


@dataclass(frozen=True)
class Secrecy:
    """What painted sources give away to somebody without the lens (section 7), on average over the views.

    psnr_db, ssim: of the sources against their targets. tiles: (N, N) likeness, 0 to 1, of each tile of the target and
    the patch that its facet looks at; chance: the same of other facets' patches.
    """

    psnr_db: float
    ssim: float
    tiles: FloatArray
    chance: float

    @property
    def metrics(self) -> dict[str, float]:
        """For the manifest."""
        return {
            "stealth_psnr_db": self.psnr_db,
            "stealth_ssim": self.ssim,
            "tile_leakage": float(self.tiles.mean()),
            "tile_leakage_by_chance": self.chance,
        }


@dataclass(frozen=True)
class RunResult:
    """Everything a run has made. Equal runs have equal data: the manifest has no timings and no file list yet.

    given: the scene before an encoder edited its sources; ``scene`` itself if there is none. first: each facet's best
    candidate, what annealing started from. renders: by renderer type, one picture per view, (R, R, C) float32, linear.
    zone: where all eyes shall see the same, what they see in between. secrecy: of painted sources. matched: how a lens
    would look that were matched to the first painted source, to compare.
    """

    given: Scene
    scene: Scene
    candidates: Candidates
    first: Assignment
    assignment: Assignment
    height_field: HeightField
    solid: Solid
    renders: Mapping[str, Sequence[FloatArray]]
    manifest: Mapping[str, Any]
    zone: Zone | None = None
    secrecy: Secrecy | None = None
    matched: Assignment | None = None
