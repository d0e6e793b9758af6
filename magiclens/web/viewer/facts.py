"""What the viewer's script is told of a run: the lens, its views and sources, small enough for a page."""

from __future__ import annotations

import base64
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, Lens, View
from magiclens.running.folder import load_heights
from magiclens.running.manifest import source_path, target_path
from magiclens.running.open_run import OpenRun
from magiclens.web.viewer.packing import pack
from magiclens.web.viewer.pictures import fitting, small

MOST_BYTES = 2_200_000
"""Of a fragment. A page with other pictures around it stays below 3 MB."""

PROGRAM_BYTES = 130_000
"""Set aside for markup, style, script, small pictures; in characters."""
LENS_BYTES = 700_000
LANDING_MM = 0.0025
"""By root mean square: how far from its place on the source rounded heights let light land, if ``LENS_BYTES`` allow."""
LEAST_SOURCE_BYTES = 100_000
"""Below this a source loses too much: rather leave frames out."""
CHIP = 40
"""Pixels of a target in the list of views."""
MOST_CHOICES = 4
"""More sources than this are frames of a film."""


def facts(lens: OpenRun) -> dict[str, Any]:
    """Everything the script needs, ready for JSON. Raises InputError if the folder has no heights."""
    heights = load_heights(lens.folder)
    packed = pack(heights, _finest_mm(lens.plan.lens), LENS_BYTES)
    room = (MOST_BYTES - PROGRAM_BYTES) * 3 // 4 - len(packed.content)
    views = _kept(lens.scene.views, room // LEAST_SOURCE_BYTES)
    sources = list(dict.fromkeys(source_path(view) for view in views))
    medium, film = lens.plan.spec.medium, len(sources) > MOST_CHOICES
    glass = {
        "heights": base64.b64encode(packed.content).decode(),
        "step": packed.step,
        "darkest": medium.black / medium.white if medium else 0.0,
        "steepest": max(_steepest_deg(heights, lens.plan.lens), 1.0),
        **_lens(lens.plan.lens, lens.scene.cut_eye_mm),
    }
    return {
        "lens": glass,
        "distance": float(np.mean([view.eye_mm[2] for view in views])) - lens.plan.lens.thickness_mm,
        "sources": [fitting(lens.folder / path, room // len(sources)) for path in sources],
        "film": film,
        "dropped": len(lens.scene.views) - len(views),
        "views": [_view(view, sources, None if film else lens.folder) for view in views],
    }


def _finest_mm(lens: Lens) -> float:
    """The step of rounded coefficients that moves landing points by ``LANDING_MM``.

    It moves every height by step / sqrt(12), a micro-facet's slope by sqrt(2) of that per its width, and a slope's
    light by the way that it has to go, times the index of refraction less one.
    """
    width = (lens.pitch_mm - lens.wall_mm) / lens.microfacets
    return LANDING_MM * width * math.sqrt(6) / ((lens.ior - 1) * (lens.thickness_mm / lens.ior + lens.gap_mm))


def _kept(views: tuple[View, ...], most_sources: int) -> list[View]:
    """The views of at most so many sources, evenly chosen."""
    sources = list(dict.fromkeys(view.source_name for view in views))
    most = max(most_sources, 1)
    if len(sources) > most:
        sources = [sources[k * len(sources) // most] for k in range(most)]
    return [view for view in views if view.source_name in sources]


def _view(view: View, sources: list[str], folder: Path | None) -> dict[str, Any]:
    """With a small picture of its target from the run folder, unless it is a frame of a film."""
    return {
        "name": view.name,
        "label": view.name.replace("-", " "),
        "eye": [float(x) for x in view.eye_mm],
        "rotation": view.rotation_deg,
        "source": sources.index(source_path(view)),
        "target": small(folder / target_path(view), CHIP) if folder else "",
    }


def _lens(lens: Lens, eye: FloatArray | None) -> dict[str, Any]:
    """Lengths in mm; ``base``: lowest and highest x, then y, of the flat bottom."""
    return {
        "facets": lens.facets, "microfacets": lens.microfacets, "size": lens.size_mm, "pitch": lens.pitch_mm,
        "wall": lens.wall_mm, "bleed": lens.bleed_mm, "relief": lens.relief_mm, "thickness": lens.thickness_mm,
        "gap": lens.gap_mm, "ior": lens.ior, "source_size": lens.source_size_mm,
        "eye": None if eye is None else [float(x) for x in eye], "base": _base(lens, eye),
    }  # fmt: skip


def _base(lens: Lens, eye: FloatArray | None) -> list[float]:
    """The rectangle of the flat bottom, which does not depend on the heights."""
    from magiclens.geometry.solid import solid_from_heights
    from magiclens.rendering.grid import grid_of

    coarse = replace(lens, microfacets=1)
    flat = solid_from_heights(HeightField(coarse, np.zeros((lens.facets, lens.facets, 2, 2)), eye))
    return [float(x) for x in grid_of(flat, coarse).floor]


def _steepest_deg(heights: FloatArray, lens: Lens) -> float:
    """The slope, degrees, that only one micro-facet in two hundred exceeds; in the reference plane's measure."""
    width = (lens.pitch_mm - lens.wall_mm) / lens.microfacets
    across, down = np.diff(heights, axis=3)[:, :, :-1], np.diff(heights, axis=2)[..., :-1]
    return float(np.degrees(np.arctan(np.percentile(np.hypot(across, down) / width, 99.5))))
