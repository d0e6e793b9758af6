"""What an eye sees when sheet, lens and eye do not lie as designed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid, View
from magiclens.rendering.tracer import picture


@dataclass(frozen=True)
class Pose:
    """How far sheet, lens and eye are from where the design has them; world frame, all 0 as designed.

    Attributes:
        shift_x_mm: Move of the sheet to the right.
        shift_y_mm: Its move upward.
        rotation_deg: Turn of the sheet about its centre, counter-clockwise as the viewer sees it.
        scale_percent: By how much the sheet is too large.
        tilt_x_deg: Turn of the lens about +x; the lowest edge of its bottom keeps the designed gap.
        tilt_y_deg: Turn of the lens about +y.
        gap_mm: Air between sheet and lens, beyond the designed gap.
        eye_x_mm: Move of the eye to the right.
        eye_y_mm: Its move upward.
        eye_z_mm: Its move away from the lens.
        ior: By how much the index of refraction is too high.
    """

    shift_x_mm: float = 0.0
    shift_y_mm: float = 0.0
    rotation_deg: float = 0.0
    scale_percent: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    gap_mm: float = 0.0
    eye_x_mm: float = 0.0
    eye_y_mm: float = 0.0
    eye_z_mm: float = 0.0
    ior: float = 0.0

    @property
    def shift_mm(self) -> FloatArray:
        """(3,) move of the sheet."""
        return np.array([self.shift_x_mm, self.shift_y_mm, 0.0])

    @property
    def tilt_deg(self) -> FloatArray:
        """(3,) turn of the lens, as a vector along its axis."""
        return np.array([self.tilt_x_deg, self.tilt_y_deg, 0.0])

    @property
    def eye_mm(self) -> FloatArray:
        """(3,) move of the eye."""
        return np.array([self.eye_x_mm, self.eye_y_mm, self.eye_z_mm])


_KEPT = 32
"""Number of traces that are kept: views that are turned look from the same places, one after the other."""


class PosedLens:
    """A lens that is seen in any pose. Sheets are moved under rays that stay; only other rays are traced."""

    def __init__(self, solid: Solid, lens: Lens, resolution: int, samples: int):
        """Args are those of ``trace``, and so are the errors."""
        from magiclens.rendering.grid import grid_of
        from magiclens.rendering.tracer_kernels import PictureRows

        self._lens, self._grid = lens, grid_of(solid, lens)
        self._rows = PictureRows(lens.size_mm, resolution, samples, 0, resolution)
        self._half = float(np.abs(solid.vertices[:, :2][solid.vertices[:, 2] == 0.0]).max(initial=lens.size_mm / 2))
        self._landing = lru_cache(maxsize=_KEPT)(self._traced)

    def picture(self, view: View, pose: Pose) -> FloatArray:
        """(R, R, C) float32, linear light, world frame: what the eye of a view sees on the lens's square."""
        seen = picture(self.landing(view, pose), view.source, self._lens.source_size_mm)
        return np.ascontiguousarray(np.rot90(seen, view.quarter_turns))

    def landing(self, view: View, pose: Pose) -> FloatArray:
        """(R, R, S, 3) float32: where on the sheet the samples of a picture land, x and y in mm, and their weight."""
        hits = self._on_sheet(view, pose)
        hits[..., :2] = _places(hits[..., :2], view, pose)
        return hits

    def _on_sheet(self, view: View, pose: Pose) -> FloatArray:
        """(R, R, S, 3) where samples meet the sheet's plane, x and y in mm from below the lens's centre, and weight."""
        from scipy.spatial.transform import Rotation

        eye, gap = view.to_lens_frame(view.eye_mm + pose.eye_mm), self._lens.gap_mm + pose.gap_mm
        if not pose.tilt_deg.any():
            return self._landing(tuple(eye), pose.ior, gap).copy()
        turn = Rotation.from_rotvec(view.to_lens_frame(pose.tilt_deg), degrees=True).as_matrix()
        lift = np.array([0.0, 0.0, self._half * np.abs(turn[2, :2]).sum()])
        at = tuple(np.round(turn.T @ (eye - lift), 9))
        # two planes that are parallel to the bottom tell where rays leave it, and where they go on to
        leaving, below = self._landing(at, pose.ior, 0.0), self._landing(at, pose.ior, 1.0)
        points = leaving[..., :2] @ turn[:, :2].T + lift
        ways = (below[..., :2] - leaving[..., :2]) @ turn[:, :2].T - turn[:, 2]
        found = points - ways * ((points[..., 2:] + gap) / ways[..., 2:])
        return np.concatenate([found[..., :2], leaving[..., 2:]], axis=-1).astype(np.float32)

    def _traced(self, eye: tuple[float, ...], ior: float, gap: float) -> FloatArray:
        """Landing points of all samples, see ``trace``, on a plane below the bottom and parallel to it."""
        from magiclens.optics.medium import slab_of
        from magiclens.rendering.tracer_kernels import trace_rows

        lens = replace(self._lens, ior=self._lens.ior + ior, gap_mm=gap)
        return trace_rows(self._grid, slab_of(lens), np.array(eye), self._rows)


def _places(points: FloatArray, view: View, pose: Pose) -> FloatArray:
    """Places on a sheet, (..., 2) mm, of points of its plane that are given in the lens frame."""
    angle = np.radians([view.rotation_deg, -pose.rotation_deg])
    turned, back = (np.array([[c, -s], [s, c]]) for c, s in zip(np.cos(angle), np.sin(angle), strict=True))
    back /= 1 + pose.scale_percent / 100
    return np.asarray(points @ (back @ turned).T.astype(np.float32) - (back @ pose.shift_mm[:2]).astype(np.float32))
