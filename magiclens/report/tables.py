"""The run in words and numbers, as the page's tables show it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from magiclens.analysis.contact_sheet import place
from magiclens.contract.artifacts import Scene
from magiclens.contract.result import RunResult
from magiclens.drawing.photographs import Photograph

LABELS = {
    "matching_psnr_db": "Bound set by matching: if every facet showed its best candidate perfectly",
    "assigned_psnr_db": "Bound after annealing: if every facet showed its choice perfectly",
    "zone_centre_psnr_db": "From the middle eye",
    "zone_worst_psnr_db": "From the worst place within the inner cone",
    "plain_centre_psnr_db": "The same of a lens for the middle eye alone: from the middle",
    "plain_worst_psnr_db": "The same of a lens for the middle eye alone: from the worst place within the inner cone",
    "source_psnr_db": "Sources as edited against those given",
    "source_ssim": "Sources as edited against those given, SSIM",
    "overlap_max": "Facets that see one pixel of a source, at most",
    "leak": "Light from pixels that are another facet's, share",
    "leak_from_reserved": "Light from reserved pixels, share",
    "stealth_psnr_db": "Sources against their targets: what is seen without the lens",
    "stealth_ssim": "Sources against their targets, SSIM",
    "tile_leakage": "Likeness of a facet's tile and the patch it looks at",
    "tile_leakage_by_chance": "Likeness of a facet's tile and another facet's patch",
    "permutation_bits": "Bits of the key that the lens is",
    "step_mean_mm": "Step between neighbouring facets, mean",
    "step_max_mm": "Step between neighbouring facets, highest",
    "slope_mean_deg": "Slope of the surface, mean",
    "slope_max_deg": "Slope of the surface, steepest",
    "facets_at_slope_limit": "Facets that are as steep as allowed",
    "z_min_mm": "Lowest point of the top, above the flat bottom",
    "z_max_mm": "Highest point of the top, above the flat bottom",
    "volume_mm3": "Volume",
    "energy_before": "Energy before annealing",
    "energy_after": "Energy after annealing",
    "energy_image": "of which image error",
    "energy_lost_light": "of which light lost at walls",
    "energy_even": "of which steps and heights",
    "annealing_rounds": "Rounds of annealing",
    "integration_rounds": "Rounds of orientation and integration",
    "integration_iterations": "Rounds of orientation and integration",
    "integration_change_mm": "Move of the surface in the last round",
    "watertight": "Mesh is watertight",
    "two_manifold": "Mesh is two-manifold",
    "consistently_oriented": "Faces are oriented alike",
    "outward_normals": "Normals point outward",
    "bodies": "Bodies",
    "zero_area_faces": "Faces without area",
    "self_intersections": "Faces that cut others",
    "as_made_psnr_db": "PSNR as the machine makes the lens, simulated",
    "fabrication_loss_db": "PSNR lost by the machine's layers, blur and polish, simulated",
    "smoothing_mm": "Farthest move of a vertex by smoothing",
}
"""What metrics are, for people who did not write them; others go by their names."""
CHECKS = {"watertight", "two_manifold", "consistently_oriented", "outward_normals"}
UNITS = {"_mm3": (1e-3, " cm³"), "_mm": (1.0, " mm"), "_deg": (1.0, "°"), "_db": (1.0, " dB"), "_px": (1.0, " px")}
"""By the end of a metric's name: factor and unit."""
HEADLINES = {"step_mean_mm": "mean step", "slope_mean_deg": "mean slope", "volume_mm3": "volume"}
CONTENTS = {
    "lens.": "the lens, in millimetres",
    "sources/": "a source, to be printed true to scale",
    "targets/": "what the eye shall see",
    "renders/": "what the simulated eye sees",
    "figures/": "a figure of this page",
    "given/": "a source as it was given",
    "animations/": "the sources in turn, or what the eye sees meanwhile",
    "heights.npz": "the top of the lens, for programs",
    "transports/": "what an eye sees of each pixel of its source, to encode and decode other pictures",
    "inputs/": "a picture that the spec uses",
    "spec.yaml": "the spec, every default written out",
    "manifest.json": "everything about the run, for programs",
    "preflight.": "whether it is fit to be made",
    "report.html": "this page",
}
"""What is in a file of a run folder, by the beginning of its path."""


class Row(NamedTuple):
    """A line of a table."""

    label: str
    value: str


class Scores(NamedTuple):
    """A view's line in the table of scores; PSNR and SSIM of each renderer."""

    view: str
    place: str
    numbers: Sequence[str]


class File(NamedTuple):
    """A file of the run folder."""

    path: str
    content: str
    size: str


def headlines(data: RunResult, seen: Mapping[str, Sequence[Photograph]]) -> list[Row]:
    """The few numbers that matter most."""
    rows = [
        Row(f"PSNR ({name})", f"{_mean([p.score.psnr_db for p in photos]):.1f} dB") for name, photos in seen.items()
    ]
    metrics = data.manifest["metrics"]
    return rows + [Row(label, measure(key, metrics[key], 3)) for key, label in HEADLINES.items() if key in metrics]


def lens_rows(scene: Scene) -> list[Row]:
    """What was decided before anything was designed."""
    lens = scene.lens
    return [
        Row("Size", f"{lens.size_mm:g} x {lens.size_mm:g} mm"),
        Row("Facets", f"{lens.facets} x {lens.facets}, {lens.pitch_mm:.4g} mm wide"),
        Row("Micro-facets", f"{lens.microfacets} x {lens.microfacets} in each facet"),
        Row("Thickness", f"{lens.thickness_mm:g} mm"),
        Row("Air between source and lens", f"{lens.gap_mm:g} mm"),
        Row("Index of refraction", f"{lens.ior:g}"),
        Row("Facets are cut", "along eye rays" if lens.cells == "eye" else "vertically"),
        Row("Source", f"{lens.source_size_mm:g} x {lens.source_size_mm:g} mm"),
    ]


def score_rows(scene: Scene, seen: Mapping[str, Sequence[Photograph]]) -> list[Scores]:
    """One row per view, and their mean where there are several."""
    turned = any(view.quarter_turns for view in scene.views)
    columns = [
        column
        for photos in seen.values()
        for column in ([p.score.psnr_db for p in photos], [p.score.ssim for p in photos])
    ]
    rows = [
        Scores(view.name, place(view, scene.lens, turned), _scores([column[k] for column in columns]))
        for k, view in enumerate(scene.views)
    ]
    mean = Scores("mean", "", _scores([_mean(column) for column in columns]))
    return [*rows, mean] if len(rows) > 1 else rows


def metric_rows(metrics: Mapping[str, float | None]) -> list[Row]:
    """Well-known metrics first, then those of plugins."""
    known = [key for key in LABELS if key in metrics]
    others = [key for key in metrics if key not in LABELS]
    return [Row(LABELS.get(key) or _words(key), measure(key, metrics[key])) for key in [*known, *others]]


def measure(key: str, value: float | None, digits: int = 4) -> str:
    """A metric with its unit, to so many significant digits."""
    if value is None:
        return "not a number"
    if key in CHECKS:
        return "yes" if value else "no"
    factor, unit = next((UNITS[end] for end in UNITS if key.endswith(end)), (1.0, ""))
    return f"{factor * value:.{digits}g}{unit}"


def option_rows(options: Mapping[str, Any]) -> list[Row]:
    """A stage's options, as YAML would write them."""
    return [Row(key, value if isinstance(value, str) else json.dumps(value)) for key, value in options.items()]


def file_rows(folder: Path) -> list[File]:
    """What the run folder holds, with the two files that are written after this."""
    sizes = {p.relative_to(folder).as_posix(): _bytes(p.stat().st_size) for p in folder.rglob("*") if p.is_file()}
    sizes |= {"manifest.json": "", "report.html": ""}
    return [File(name, _content(name), sizes[name]) for name in sorted(sizes)]


def _content(name: str) -> str:
    return next((text for start, text in CONTENTS.items() if name.startswith(start)), "")


def _bytes(size: float) -> str:
    units = ["bytes", "kB", "MB", "GB"]
    while size >= 1000 and len(units) > 1:
        size /= 1000
        units.pop(0)
    return f"{size:.3g} {units[0]}"


def _words(key: str) -> str:
    """A plugin's metric without the unit at its end."""
    end = next((end for end in UNITS if key.endswith(end)), "")
    return key.removesuffix(end).replace("_", " ").capitalize()


def _scores(values: Sequence[float]) -> list[str]:
    return [f"{value:.3f}" if k % 2 else f"{value:.2f} dB" for k, value in enumerate(values)]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
