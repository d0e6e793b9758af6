"""How far layers throw light off: where rays land through the print, beside where they would without layers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magiclens.analysis.base import Analysis, Findings
from magiclens.contract.artifacts import FloatArray
from magiclens.contract.result import RunResult
from magiclens.drawing.figure import Figure
from magiclens.drawing.scales import GLOW, ColourScale
from magiclens.drawing.tiles import Tile
from magiclens.plan.compile import Plan
from magiclens.processes.layers import Slicing
from magiclens.profiles.machines import Printer

_NAMES: Mapping[Slicing, str] = {"plain": "Layers rounded plainly", "diffused": "Layers rounded by error diffusion"}
"""Titles by the slicing, see ``Printer``."""


def _applies(plan: Plan) -> bool:
    return plan.fabrication is not None and isinstance(plan.fabrication.machine, Printer)


def _compute(plan: Plan, result: RunResult) -> Findings | None:
    from magiclens.simulation.ray_errors import inside_facets, ray_errors

    assert plan.fabrication is not None
    printer = plan.fabrication.machine
    assert isinstance(printer, Printer)
    if result.solid.grid is None:
        return None
    errors = ray_errors(result.scene.lens, result.scene.views[0], result.solid, printer, tuple(_NAMES))
    inside = inside_facets(result.scene.lens, printer.linear_process.strip_mm, len(errors["plain"]))
    rms = {f"ray_error_{slicing}_mm": _rms(each[inside]) for slicing, each in errors.items()}
    return Findings(rms, details=errors)


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else 0.0


def _figures(result: RunResult, findings: Findings) -> list[Figure]:
    errors: dict[Slicing, FloatArray] = findings.details
    highest = float(np.nanquantile(errors["plain"], 0.99)) if np.isfinite(errors["plain"]).any() else 0.0
    scale = ColourScale(GLOW, 0.0, max(highest, 1e-3))
    tiles = [
        Tile(
            scale.paint(np.nan_to_num(each)),
            f"{_NAMES[slicing]}, mm",
            f"{findings.metrics[f'ray_error_{slicing}_mm']:.3f} mm rms inside facets",
            scale,
        )
        for slicing, each in errors.items()
    ]
    caption = "How far from where they should, on the sheet, rays land because the printer builds in layers."
    return [Figure("ray-errors", "What layers throw off", [tiles], caption)]


RAY_ERROR = Analysis("ray-error", _applies, _compute, _figures)
"""The error of rays by layers, for either slicing."""
