"""Parts that stand tilted on the build plate, so that no gentle slope of theirs lies along the layers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from magiclens.contract.artifacts import FloatArray, Solid
from magiclens.contract.units import Angle


class Tilt(BaseModel):
    """How a part is turned before it stands on the plate; its supports are below the flat side.

    The *plate frame* is the lens frame after that turn, its z counted from the part's lowest point.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    about: Literal["x", "y"] = Field("x", description="the axis of the lens about which it is turned")
    angle: Angle = Field(
        "30deg", validate_default=True, ge=-75, le=75,
        description="right-handed: a positive one lifts the edge at +y, or at -x, off the plate",
    )  # fmt: skip

    @property
    def turn(self) -> FloatArray:
        """(3, 3) the rotation from the lens frame to the plate's."""
        c, s = math.cos(math.radians(self.angle)), math.sin(math.radians(self.angle))
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]] if self.about == "x" else [[c, 0, s], [0, 1, 0], [-s, 0, c]])

    def box_mm(self, sides_mm: FloatArray) -> FloatArray:
        """(3,) sides of the upright box around a turned box of sides (3,), mm."""
        return np.asarray(np.abs(self.turn) @ sides_mm)

    def lowest_mm(self, solid: Solid) -> float:
        """Where a turned solid is lowest, above the lens frame's origin, which is negative."""
        return float((solid.vertices @ self.turn[2]).min())

    def stood(self, solid: Solid) -> Solid:
        """The solid in the plate frame; it has no grid."""
        low = np.array([0.0, 0.0, self.lowest_mm(solid)])
        return replace(solid, vertices=solid.vertices @ self.turn.T - low, grid=None, eye_mm=None)

    def lying(
        self, heights: FloatArray, x_mm: FloatArray, y_mm: FloatArray, wanted: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        """The highest points of a surface that was made tilted, in the lens frame.

        A turn about an axis leaves planes across it where they are, so every column (or row) is turned by itself.

        Args:
            heights: (rows, columns) of the plate frame, above the plane through the origin, mm.
            x_mm: (columns,) ascending, of the plate frame.
            y_mm: (rows,) descending.
            wanted: x ascending and y descending of the result, lens frame; along the axis those of ``heights``.

        Returns:
            (rows, columns) float32 of the wanted raster, mm; -inf where nothing was made.
        """
        from magiclens.kernels.threads import in_threads
        from magiclens.processes.tilting_kernels import turn_back_part

        # one formula for both axes: a turn about y is one about x whose y axis points to -x; both lists descend
        lines, at, to = (heights.T, y_mm, wanted[1]) if self.about == "x" else (heights, -x_mm, -wanted[0])
        lines, at, to = (np.ascontiguousarray(each[..., ::-1], np.float64) for each in (lines, at, to))
        angle = math.radians(self.angle)
        found = np.full((len(lines), len(to)), -np.inf, np.float32)
        in_threads(turn_back_part, len(lines), lines, at, (math.cos(angle), math.sin(angle)), to, found)
        return found[:, ::-1].T if self.about == "x" else found[:, ::-1]
