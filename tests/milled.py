"""Lenses, grooves and milled programs for tests of milling."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fabricated import LENS, written
from magiclens.contract.artifacts import FloatArray, HeightField, Lens, Solid
from magiclens.geometry.solid import solid_from_heights
from magiclens.milling.cutter import Cutter
from magiclens.milling.exporter import MillingExporter
from magiclens.milling.program import MillingProgram
from magiclens.simulation.machining import MachinedTop, run_programs

BALL: dict[str, Any] = {"shape": "ball", "diameter": "1mm"}
FLAT: dict[str, Any] = {"shape": "flat", "diameter": "1mm"}
V: dict[str, Any] = {"shape": "v", "diameter": "2mm", "angle": "60deg", "tip": "0.1mm"}
POINTED: dict[str, Any] = {**V, "tip": "0mm"}
WAVES = Lens(size_mm=6.0, source_size_mm=6.0, facets=2, microfacets=8, thickness_mm=8.0, wall_mm=0.002)


def waves(lens: Lens = WAVES, eye: FloatArray | None = None) -> Solid:
    """A slab whose top is smooth and nowhere symmetric."""
    points = HeightField(lens, np.zeros((lens.facets,) * 2 + (lens.microfacets + 1,) * 2), None).facet_points_mm()
    x, y = points[..., 0], points[..., 1]
    heights = 0.2 * np.sin(1.1 * x + 0.4 * y) + 0.1 * np.cos(1.7 * y - 0.3 * x) + 0.02 * x
    return solid_from_heights(HeightField(lens, heights, eye))


def groove(slope: float, lens: Lens = LENS) -> Solid:
    """A slab with a V-shaped groove along y, its bottom at x = 0 and z = the lens's thickness."""
    one = Lens(lens.size_mm, lens.size_mm, 1, 2, lens.thickness_mm, wall_mm=1e-6, relief_mm=20.0)
    rise = slope * lens.size_mm / 2
    heights = np.broadcast_to(np.array([rise, 0.0, rise]), (1, 1, 3, 3))
    return solid_from_heights(HeightField(one, heights.copy(), None))


def cutter(options: dict[str, Any]) -> Cutter:
    """A cutter from options as a spec writes them."""
    return Cutter.model_validate(options)


def programs_of(exporter: MillingExporter, path: Path) -> list[MillingProgram]:
    """The programs in the exporter's files, read back."""
    return [exporter.read_program(file) for file in exporter.program_files(path)]


def machined(exporter: MillingExporter, folder: Path, solid: Solid) -> MachinedTop:
    """The lens that the exporter's files make."""
    return run_programs(programs_of(exporter, written(exporter, folder, solid)), solid)
