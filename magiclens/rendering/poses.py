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


_KEPT = 16
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
        self._rays = lru_cache(maxsize=_KEPT)(self._traced)

    def picture(self, view: View, pose: Pose) -> FloatArray:
        """(R, R, C) float32, linear light, world frame: what the eye of a view sees on the lens's square."""
        seen = picture(self.landing(view, pose), view.source, self._lens.source_size_mm)
        return np.ascontiguousarray(np.rot90(seen, view.quarter_turns))

    def landing(self, view: View, pose: Pose) -> FloatArray:
        """(R, R, S, 3) float32: where on the sheet the samples of a picture land, x and y in mm, and their weight."""
        from scipy.spatial.transform import Rotation

        from magiclens.rendering.source_kernels import meet_sheet

        tilt = Rotation.from_rotvec(view.to_lens_frame(pose.tilt_deg), degrees=True).as_matrix()
        lift = np.array([0.0, 0.0, self._half * np.abs(tilt[2, :2]).sum()])
        eye = tilt.T @ (view.to_lens_frame(view.eye_mm + pose.eye_mm) - lift)
        turn, move = _to_sheet(view, pose)
        above = lift + np.array([0.0, 0.0, self._lens.gap_mm + pose.gap_mm])
        return meet_sheet(self._rays(tuple(np.round(eye, 9)), pose.ior), turn @ tilt, turn @ above + move)

    def _traced(self, eye: tuple[float, ...], ior: float) -> FloatArray:
        """The rays of all samples below the bottom, see ``trace_rays``."""
        from magiclens.optics.medium import slab_of
        from magiclens.rendering.tracer_kernels import trace_rays

        lens = replace(self._lens, ior=self._lens.ior + ior)
        return trace_rays(self._grid, slab_of(lens), np.array(eye), self._rows)


def _to_sheet(view: View, pose: Pose) -> tuple[FloatArray, FloatArray]:
    """Turn and scale (3, 3), and move (3,) in mm, that take points of the lens frame to places on the sheet."""
    angle = np.radians([view.rotation_deg, -pose.rotation_deg])
    turns = zip(np.cos(angle), np.sin(angle), strict=True)
    turned, back = (np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) for c, s in turns)
    back[:2] /= 1 + pose.scale_percent / 100
    return back @ turned, -back @ pose.shift_mm
