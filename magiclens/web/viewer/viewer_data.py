"""The data of the viewer's script: the lens, its views and its sources, small enough for a page."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from magiclens.contract.artifacts import FloatArray, HeightField, Lens, View
from magiclens.running.manifest import source_path, target_path
from magiclens.running.open_run import OpenRun
from magiclens.running.run_files import RunFiles
from magiclens.scenarios.base import Shot
from magiclens.web.viewer.film import FILM_BYTES
from magiclens.web.viewer.packing import pack_heights
from magiclens.web.viewer.pictures import picture_uri_within, thumbnail_uri

MOST_BYTES = 2_400_000
"""Greatest length of a fragment; a page with other pictures around it stays below 3 MB."""
LANDING_MM = 0.0025
"""Root mean square by which rounding the heights moves the points on the source that are seen, mm.

It is larger if ``_HEIGHTS_BYTES`` are too few."""
_PROGRAM_BYTES = 140_000 + FILM_BYTES
"""Bytes that markup, style, script, thumbnails and the film take, at most."""
_HEIGHTS_BYTES = 700_000
"""Most bytes of the packed heights."""
_DESIGNED_BYTES = 350_000
"""Most bytes of the packed heights of the design, where the lens is shown as printed first."""
_LEAST_SOURCE_BYTES = 100_000
"""Fewest bytes of a source: below this a source loses too much, and frames are left out instead."""
_THUMBNAIL_SIDE = 40
"""Width and height of a target in the list of views, pixels."""
MOST_CHOICES = 4
"""Most sources of a list of views; more are frames of a film."""


def viewer_data(lens: OpenRun) -> dict[str, Any]:
    """Everything that the script needs, ready for JSON; of a lens that names its printer, the printed top comes first.

    Raises:
        InputError: The folder has no heights.
    """
    made = lens.top_as_made
    tops = [_top_data(made, _HEIGHTS_BYTES)]
    if made is not lens.top:
        tops.append(_top_data(lens.top, _DESIGNED_BYTES))
    # base64 takes four characters for three bytes
    room = (MOST_BYTES - _PROGRAM_BYTES - sum(len(top["heights"]) for top in tops)) * 3 // 4
    views = keep_views(lens.scene.views, room // _LEAST_SOURCE_BYTES)
    sources = list(dict.fromkeys(source_path(view) for view in views))
    labels = view_labels(lens.plan.shots())
    medium, film = lens.plan.spec.medium, len(sources) > MOST_CHOICES
    lens_data = {
        "darkest": medium.black / medium.white if medium else 0.0,
        "steepest": max(_steepest_deg(made.heights_mm, lens.plan.lens), 1.0),
        **_lens_data(lens.plan.lens),
    }
    return {
        "lens": lens_data,
        "tops": tops,
        "distance": float(np.mean([view.eye_mm[2] for view in views])) - lens.plan.lens.thickness_mm,
        "sources": [picture_uri_within(lens.files.file(path), room // len(sources)) for path in sources],
        "film": film,
        "bears": _bears(lens.files.manifest["metrics"]),
        "dropped": len(lens.scene.views) - len(views),
        "views": [_view_data(view, labels[view.name], sources, None if film else lens.files) for view in views],
    }


def _bears(metrics: Mapping[str, float | None]) -> dict[str, tuple[float, float]]:
    """How far each value of the pose may be from its home, by its name in the script; nothing if it is not known."""
    names = {"x": "shift_x_mm", "y": "shift_y_mm", "angle": "rotation_deg", "eyeX": "eye_x_mm", "eyeY": "eye_y_mm"}
    may = {name: metrics.get(f"tolerance_{tolerance}") for name, tolerance in names.items()}
    found = {name: (-value, value) for name, value in may.items() if value is not None}
    lift, near, far = (metrics.get(f"tolerance_{name}_mm") for name in ("gap", "eye_nearer", "eye_farther"))
    if lift is not None and near is not None and far is not None:
        found |= {"lift": (0.0, lift), "eyeDistance": (-near, far)}
    return found


def finest_step_mm(lens: Lens) -> float:
    """The step of rounded coefficients, mm, that moves the points seen on the source by ``LANDING_MM``.

    Rounding moves each height by step / sqrt(12), and the slope of a micro-facet by sqrt(2) of that over its width. The
    slope turns the ray by itself times the index of refraction less one, and the ray goes on to the source.
    """
    width = (lens.pitch_mm - lens.wall_mm) / lens.microfacets
    return LANDING_MM * width * math.sqrt(6) / ((lens.ior - 1) * (lens.thickness_mm / lens.ior + lens.gap_mm))


def keep_views(views: tuple[View, ...], most_sources: int) -> list[View]:
    """The views of at most so many sources, evenly chosen."""
    sources = list(dict.fromkeys(view.source_name for view in views))
    most = max(most_sources, 1)
    if len(sources) > most:
        sources = [sources[k * len(sources) // most] for k in range(most)]
    return [view for view in views if view.source_name in sources]


def view_labels(shots: Sequence[Shot]) -> dict[str, str]:
    """What people call the views, by name: as their targets, or by their own names where targets are alike."""
    titles = {shot.name: shot.target.title for shot in shots}
    own = {name: name.replace("-", " ") for name in titles}
    many = Counter(titles.values())
    return {name: title if title and many[title] == 1 else own[name] for name, title in titles.items()}


def _view_data(view: View, label: str, sources: list[str], files: RunFiles | None) -> dict[str, Any]:
    """A view with a thumbnail of its target; without one if it is a frame of a film, which is given no ``files``."""
    return {
        "name": view.name,
        "label": label,
        "eye": [float(x) for x in view.eye_mm],
        "rotation": view.rotation_deg,
        "source": sources.index(source_path(view)),
        "target": thumbnail_uri(files.file(target_path(view)), _THUMBNAIL_SIDE) if files else "",
    }


def _top_data(top: HeightField, most_bytes: int) -> dict[str, Any]:
    """A top; ``base`` is the lowest and highest x, then y, of the flat bottom, mm."""
    packed = pack_heights(top.heights_mm, finest_step_mm(top.lens), most_bytes)
    return {
        "heights": base64.b64encode(packed.content).decode(),
        "step": packed.step,
        "eye": None if top.eye_mm is None else [float(x) for x in top.eye_mm],
        "base": _base(top.lens, top.eye_mm),
    }


def _lens_data(lens: Lens) -> dict[str, Any]:
    """Lengths in mm."""
    return {
        "facets": lens.facets, "microfacets": lens.microfacets, "size": lens.size_mm, "pitch": lens.pitch_mm,
        "wall": lens.wall_mm, "bleed": lens.bleed_mm, "relief": lens.relief_mm, "thickness": lens.thickness_mm,
        "gap": lens.gap_mm, "ior": lens.ior, "source_size": lens.source_size_mm,
    }  # fmt: skip


def _base(lens: Lens, eye: FloatArray | None) -> list[float]:
    """The rectangle of the flat bottom, which does not depend on the heights."""
    from magiclens.geometry.solid import solid_from_heights
    from magiclens.rendering.grid import grid_of

    coarse = replace(lens, microfacets=1)
    flat = solid_from_heights(HeightField(coarse, np.zeros((lens.facets, lens.facets, 2, 2)), eye))
    return [float(x) for x in grid_of(flat, coarse).floor]


def _steepest_deg(heights: FloatArray, lens: Lens) -> float:
    """The slope, degrees, that only one micro-facet in two hundred exceeds; measured over the reference plane."""
    width = (lens.pitch_mm - lens.wall_mm) / lens.microfacets
    across, down = np.diff(heights, axis=3)[:, :, :-1], np.diff(heights, axis=2)[..., :-1]
    return float(np.degrees(np.arctan(np.percentile(np.hypot(across, down) / width, 99.5))))
