"""How far from where they should rays land because a printer builds in layers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magiclens.contract.artifacts import BoolArray, FloatArray, Lens, Solid, View
from magiclens.processes.layers import Slicing
from magiclens.profiles.machines import Printer
from magiclens.rendering.tracer import trace
from magiclens.simulation.as_printed import as_printed, without_layers

_RESOLUTION = 512
"""Rays along the side of the lens."""


def ray_errors(
    lens: Lens, view: View, solid: Solid, printer: Printer, slicings: Sequence[Slicing]
) -> dict[Slicing, FloatArray]:
    """Errors of a view's rays by layers alone, for every slicing.

    Args:
        lens: The lens.
        view: Its eye is used.
        solid: The design, with a grid.
        printer: What makes it.
        slicings: How heights become layers.

    Returns:
        (R, R) mm on the sheet, lens frame; nan where a ray does not arrive.
    """
    right = _landings(lens, view, without_layers(solid, printer))
    errors = {}
    for each in sorted(slicings, key=lambda slicing: slicing != printer.slicing):  # its own body may be there already
        body = as_printed(solid, printer.model_copy(update={"slicing": each}))
        errors[each] = np.hypot(*np.moveaxis(_landings(lens, view, body) - right, -1, 0))
    return {each: errors[each] for each in slicings}


def _landings(lens: Lens, view: View, body: Solid) -> FloatArray:
    hits = trace(body, lens, view, _RESOLUTION, 1)[:, :, 0]
    return np.where(hits[..., 2:] > 0, hits[..., :2], np.nan)


def inside_facets(lens: Lens, strip_mm: float, resolution: int) -> BoolArray:
    """(R, R) which pixels of a picture are not in the strips, of this width, along the borders of facets."""
    at = (np.arange(resolution) + 0.5) / resolution * lens.facets
    away = np.abs(at - np.rint(at)) * lens.pitch_mm > strip_mm / 2
    return np.logical_and.outer(away, away)
