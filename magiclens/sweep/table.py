"""A sweep in numbers: text for people, CSV for spreadsheets, JSON for programs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from statistics import mean
from typing import Any

from magiclens.running.manifest import REFERENCE_RENDERER
from magiclens.sweep.results import Sweep, SweepResult

_FORMAT = 1
"""Version of ``sweep.json``."""
_FIRST_METRICS = ("step_mean_mm", "step_max_mm", "slope_mean_deg", "volume_mm3")
"""Metrics in the first columns; the others follow by name."""


def sweep_json(sweep: Sweep) -> str:
    """The text of ``sweep.json``."""
    return json.dumps(sweep_data(sweep), indent=2, allow_nan=False) + "\n"


def sweep_data(sweep: Sweep) -> dict[str, Any]:
    """Each combination with its values, folder, scores and metrics, or why it failed; ready for JSON."""
    rows = [_row(result) for result in sweep.results]
    return {"format": _FORMAT, "spec": sweep.spec, "keys": list(sweep.keys), "combinations": rows}


def sweep_csv(sweep: Sweep) -> str:
    """One line for each combination; a cell is empty if the combination does not have the number."""
    rows = [_row(result) for result in sweep.results]
    scores = ["psnr_db", "ssim", "seconds"]
    metrics = list(dict.fromkeys([*_FIRST_METRICS, *sorted({name for row in rows for name in row["metrics"]})]))
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow([*sweep.keys, "status", *scores, *metrics, "folder", "error"])
    for row in rows:
        numbers = [row[name] for name in scores] + [row["metrics"].get(name) for name in metrics]
        lines.writerow([*row["values"].values(), row["status"], *numbers, row["folder"], row["error"]])
    return text.getvalue()


def sweep_text(sweep: Sweep) -> str:
    """A table for a terminal, and the files of the sheet."""
    rows = [[*sweep.keys, "PSNR", "SSIM", "seconds", ""]]
    for row in (_row(result) for result in sweep.results):
        numbers = [_short(row["psnr_db"], ".2f"), _short(row["ssim"], ".3f"), _short(row["seconds"], ".1f")]
        rows.append([*row["values"].values(), *numbers, row["error"] or ""])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines, "", f"{sweep.folder}: sweep.html, sweep.png, sweep.csv, sweep.json"])


def compared_renderer(manifest: Mapping[str, Any]) -> str | None:
    """The renderer whose pictures are compared: the reference renderer, or the first; None if there is none."""
    renderers = list(manifest["views"][0]["renders"])
    return REFERENCE_RENDERER if REFERENCE_RENDERER in renderers else next(iter(renderers), None)


def mean_scores(manifest: Mapping[str, Any]) -> dict[str, float | None]:
    """Means over the views of ``psnr_db`` and ``ssim`` of the compared renderer; None if one has no number."""
    renderer = compared_renderer(manifest)
    suffix = "" if renderer in (REFERENCE_RENDERER, None) else f"_{renderer}"
    return {name: _mean([view.get(f"{name}{suffix}") for view in manifest["views"]]) for name in ("psnr_db", "ssim")}


def _row(result: SweepResult) -> dict[str, Any]:
    made = result.manifest
    numbers: dict[str, float | None] = dict.fromkeys(("psnr_db", "ssim", "seconds"))
    if made:
        numbers = {**mean_scores(made), "seconds": made["seconds"]}
    return {
        "values": dict(result.combination.values),
        "folder": result.combination.folder,
        "status": "done" if made else "failed",
        "error": result.error or None,
        **numbers,
        "metrics": dict(made["metrics"]) if made else {},
    }


def _short(value: float | None, digits: str) -> str:
    return "-" if value is None else f"{value:{digits}}"


def _mean(values: list[float | None]) -> float | None:
    # a mean over some of the views only would compare unlike things
    known = [value for value in values if value is not None]
    return mean(known) if len(known) == len(values) else None
