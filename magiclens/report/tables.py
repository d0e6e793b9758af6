"""The rows of a report's tables: what was run, in words and numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from magiclens.analysis.contact_sheet import view_placement
from magiclens.contract.artifacts import Scene
from magiclens.images.score import ScoresByRenderer

_METRIC_LABELS = {
    "matching_psnr_db": "If facets were lenslets and showed their best candidates perfectly; refinement goes beyond",
    "assigned_psnr_db": "The same of the candidates that annealing chose",
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
    "shown_in_sheet": "SSIM of source and target, tile by tile: up to 0.1 hidden, up to 0.3 guessable, else plain",
    "permutation_bits": "Bits of the key that the lens is",
    "step_mean_mm": "Step between neighbouring facets, mean",
    "step_max_mm": "Step between neighbouring facets, highest",
    "slope_mean_deg": "Slope of the surface, mean",
    "slope_max_deg": "Slope of the surface, steepest",
    "facets_at_slope_limit": "Facets that are as steep as allowed",
    "z_min_mm": "Lowest point of the top, above the flat bottom",
    "z_max_mm": "Highest point of the top, above the flat bottom",
    "volume_mm3": "Volume",
    "width_mm": "Width of the part",
    "depth_mm": "Depth of the part",
    "height_mm": "Height of the part",
    "energy_before": "Energy before annealing",
    "energy_after": "Energy after annealing",
    "energy_image": "of which image error",
    "energy_lost_light": "of which light lost at walls",
    "energy_even": "of which steps and heights",
    "energy_bound": "Energy that no choice could be below",
    "energy_above_bound_percent": "Energy above that bound, at most",
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
    "ray_error_plain_mm": "Ray error by layers that are rounded plainly, rms inside facets",
    "ray_error_diffused_mm": "Ray error by layers that are rounded by error diffusion",
    "tolerance_shift_x_mm": "Sheet may lie aside by, each costing 3 dB of the worst view",
    "tolerance_shift_y_mm": "Sheet may lie higher or lower by",
    "tolerance_rotation_deg": "Sheet may be turned by",
    "tolerance_scale_percent": "Sheet may be too large or too small by",
    "tolerance_tilt_x_deg": "Lens may lean, upper or lower edge lifted, by",
    "tolerance_tilt_y_deg": "Lens may lean, left or right edge lifted, by",
    "tolerance_gap_mm": "Air between sheet and lens may differ by",
    "tolerance_eye_x_mm": "Eye may be aside by",
    "tolerance_eye_y_mm": "Eye may be higher or lower by",
    "tolerance_eye_nearer_mm": "Eye may be nearer by",
    "tolerance_eye_farther_mm": "Eye may be farther away by",
    "tolerance_ior": "Index of refraction may differ by",
    "smoothing_mm": "Farthest move of a vertex by smoothing",
}
"""Labels of metrics, in the order of the table; metrics that are not listed follow under their own names."""
_CHECKS = {"watertight", "two_manifold", "consistently_oriented", "outward_normals"}
"""Metrics that are 1 for yes and 0 for no."""
_UNITS = {
    "_mm3": (1e-3, " cm³"),
    "_mm": (1.0, " mm"),
    "_deg": (1.0, "°"),
    "_db": (1.0, " dB"),
    "_px": (1.0, " px"),
    "_percent": (1.0, " %"),
}
"""Factor and unit of a metric, by the end of its name; the longer of two ends comes first."""
_SIDES = ("width_mm", "depth_mm", "height_mm")
"""Metrics that say how large the part is."""
_HEADLINE_METRICS = {"step_mean_mm": "mean step", "slope_mean_deg": "mean slope", "volume_mm3": "volume"}
"""Labels of the metrics at the top of the page."""
_FILE_CONTENTS = {
    "lens.jig": "a part that holds sheet, lens or eye in place, to be printed",
    "lens.pdf": "the sources, to be printed true to scale",
    "lens.monitor": "a source for a screen, pixel for pixel",
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
"""What a file of a run folder holds, by the beginning of its path."""


_BESIDE_THE_LENS = ("jig", "monitor", "pdf")
"""Files of exporters that hold no lens, by what follows ``lens.``: the jig, pictures for screens, the sheet."""
_MOST_SOURCES = 8
"""Most sources that the errands name; an animation has many more."""


class TableRow(NamedTuple):
    """A line of a table with two columns."""

    label: str
    value: str


class ScoreRow(NamedTuple):
    """A line of the table of scores.

    ``placement`` says where lens and eye are; ``numbers`` are PSNR and SSIM of each renderer in turn.
    """

    view: str
    placement: str
    numbers: Sequence[str]


class FileRow(NamedTuple):
    """A line of the table of files."""

    path: str
    content: str
    size: str


class Errand(NamedTuple):
    """Something to be done to have the lens in hand: what, with which files of the run folder, and how."""

    title: str
    files: Sequence[str]
    how: str


def verdict_of_run(folder: Path) -> Mapping[str, Any] | None:
    """The verdict that preflight has left in a run folder; None if there is no mesh, and so no preflight."""
    path = folder / "preflight.json"
    if not path.is_file():
        return None
    verdict: Mapping[str, Any] | None = json.loads(path.read_text(encoding="utf-8")).get("verdict")
    return verdict


def errands(scene: Scene, metrics: Mapping[str, float | None], folder: Path) -> list[Errand]:
    """What is to be done to have the lens in hand, with the files of a run folder that it takes."""
    lens, view = scene.lens, scene.views[0]
    # more than the lens's square: cells along eye rays widen toward the bottom, and printers need a rim
    sides = [side for key in _SIDES if (side := metrics.get(key)) is not None]
    large = f"; the part is {' x '.join(f'{side:.4g}' for side in sides)} mm" if len(sides) == len(_SIDES) else ""
    beside = sorted(path.name for path in folder.glob("lens.*"))
    jig, screen, sheet = ([name for name in beside if name.startswith(f"lens.{kind}")] for kind in _BESIDE_THE_LENS)
    bodies = [name for name in beside if name not in {*jig, *screen, *sheet}]
    sources = sheet or sorted(path.relative_to(folder).as_posix() for path in folder.glob("sources/*.png"))
    size = "at 100 %, without fitting to the page" if sheet else f"exactly {lens.source_size_mm:g} mm wide"
    many = f"; {len(sources)} in all" if len(sources) > 1 else ""
    x, y, z = view.eye_mm
    aside = f", {x:+.0f} mm to the right and {y:+.0f} mm up" if abs(x) + abs(y) > 0.5 else ""
    eye = f"with one eye, {z - lens.thickness_mm:.0f} mm above the lens{aside}"
    found = [
        Errand("Check it", [n for n in ("preflight.html",) if (folder / n).is_file()], "whether it is fit to be made"),
        Errand("Have the lens made", bodies, f"send one of these to the maker, in mm{large}"),
        Errand("Print the sheet", sources[:_MOST_SOURCES], f"{size}{many}"),
        Errand("Print the jig", jig, "in any plastic; it holds sheet, lens and eye in place"),
        Errand("Or show it on a screen", screen, "pixel for pixel"),
    ]
    return [*(errand for errand in found if errand.files), Errand(f"Look through it: {view.name}", [], eye)]


def headline_rows(metrics: Mapping[str, float | None], scores: ScoresByRenderer) -> list[TableRow]:
    """The few numbers at the top of the page, of the manifest's metrics and the scores of each renderer's pictures."""
    rows = [
        TableRow(f"PSNR as designed ({name})", f"{_mean([score.psnr_db for score in of_views]):.1f} dB")
        for name, of_views in scores.items()
    ]
    return rows + metric_headlines(metrics, _HEADLINE_METRICS)


def metric_headlines(metrics: Mapping[str, float | None], labels: Mapping[str, str]) -> list[TableRow]:
    """Rows of the metrics that are there, to three digits; ``labels`` are the metrics wanted and their labels."""
    return [TableRow(label, format_metric(key, metrics[key], 3)) for key, label in labels.items() if key in metrics]


def lens_rows(scene: Scene) -> list[TableRow]:
    """The measures of the lens that the spec sets."""
    lens = scene.lens
    return [
        TableRow("Size", f"{lens.size_mm:g} x {lens.size_mm:g} mm"),
        TableRow("Facets", f"{lens.facets} x {lens.facets}, {lens.pitch_mm:.4g} mm wide"),
        TableRow("Micro-facets", f"{lens.microfacets} x {lens.microfacets} in each facet"),
        TableRow("Thickness", f"{lens.thickness_mm:g} mm"),
        TableRow("Air between source and lens", f"{lens.gap_mm:g} mm"),
        TableRow("Index of refraction", f"{lens.ior:g}"),
        TableRow("Facets are cut", "along eye rays" if lens.cells == "eye" else "vertically"),
        TableRow("Source", f"{lens.source_size_mm:g} x {lens.source_size_mm:g} mm"),
    ]


def score_rows(scene: Scene, scores: ScoresByRenderer) -> list[ScoreRow]:
    """One row for each view, and their mean if there are several."""
    turned = any(view.quarter_turns for view in scene.views)
    columns = [
        column
        for of_views in scores.values()
        for column in ([score.psnr_db for score in of_views], [score.ssim for score in of_views])
    ]
    rows = [
        ScoreRow(view.name, view_placement(view, scene.lens, turned), _scores([column[k] for column in columns]))
        for k, view in enumerate(scene.views)
    ]
    mean = ScoreRow("mean", "", _scores([_mean(column) for column in columns]))
    return [*rows, mean] if len(rows) > 1 else rows


def metric_rows(metrics: Mapping[str, float | None]) -> list[TableRow]:
    """Metrics that have a label first, then those of plugins."""
    known = [key for key in _METRIC_LABELS if key in metrics]
    others = [key for key in metrics if key not in _METRIC_LABELS]
    labels = {key: _METRIC_LABELS.get(key) or _words(key) for key in [*known, *others]}
    return [TableRow(label, format_metric(key, metrics[key])) for key, label in labels.items()]


def format_metric(key: str, value: float | None, digits: int = 4) -> str:
    """Write a metric with its unit.

    Args:
        key: Name of the metric; its end tells the unit.
        value: The metric; None where it is no finite number.
        digits: Significant digits.
    """
    if value is None:
        return "not a number"
    if key in _CHECKS:
        return "yes" if value else "no"
    factor, unit = next((_UNITS[end] for end in _UNITS if key.endswith(end)), (1.0, ""))
    return f"{factor * value:.{digits}g}{unit}"


def option_rows(options: Mapping[str, Any]) -> list[TableRow]:
    """The options of a stage, as YAML writes them."""
    return [TableRow(key, value if isinstance(value, str) else json.dumps(value)) for key, value in options.items()]


def file_rows(folder: Path) -> list[FileRow]:
    """Every file of a run folder, and the two that are written after the page is filled."""
    sizes = {p.relative_to(folder).as_posix(): format_bytes(p.stat().st_size) for p in folder.rglob("*") if p.is_file()}
    sizes |= {"manifest.json": "", "report.html": ""}
    return [FileRow(name, _content(name), sizes[name]) for name in sorted(sizes)]


def format_bytes(size: float) -> str:
    """Write a number of bytes for people: three digits and a unit."""
    for unit in ("bytes", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"


def _content(name: str) -> str:
    return next((text for start, text in _FILE_CONTENTS.items() if name.startswith(start)), "")


def _words(key: str) -> str:
    """The name of a metric as words, without its unit."""
    end = next((end for end in _UNITS if key.endswith(end)), "")
    return key.removesuffix(end).replace("_", " ").capitalize()


def _scores(values: Sequence[float]) -> list[str]:
    return [f"{value:.3f}" if k % 2 else f"{value:.2f} dB" for k, value in enumerate(values)]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
