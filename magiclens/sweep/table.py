"""A sweep in numbers: rows for people, CSV for spreadsheets, JSON for programs."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from statistics import mean
from typing import TYPE_CHECKING, Any

from magiclens.running.manifest import REFERENCE_RENDERER

if TYPE_CHECKING:
    from magiclens.sweep.sweeping import Result, Sweep

FORMAT = 1
FIRST = ("step_mean_mm", "step_max_mm", "slope_mean_deg", "volume_mm3")
"""Metrics that come before the others."""


def as_json(sweep: Sweep) -> str:
    """Every combination with its values, its folder, its scores and its metrics, or why it failed."""
    return json.dumps(facts(sweep), indent=2, allow_nan=False) + "\n"


def facts(sweep: Sweep) -> dict[str, Any]:
    """What ``sweep.json`` holds."""
    rows = [_facts(result) for result in sweep.results]
    return {"format": FORMAT, "spec": sweep.spec, "keys": list(sweep.keys), "combinations": rows}


def as_csv(sweep: Sweep) -> str:
    """One line per combination; numbers that a combination has not are empty."""
    rows = [_facts(result) for result in sweep.results]
    scores = ["psnr_db", "ssim", "seconds"]
    metrics = list(dict.fromkeys([*FIRST, *sorted({name for row in rows for name in row["metrics"]})]))
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow([*sweep.keys, "status", *scores, *metrics, "folder", "error"])
    for row in rows:
        numbers = [row[name] for name in scores] + [row["metrics"].get(name) for name in metrics]
        lines.writerow([*row["values"].values(), row["status"], *numbers, row["folder"], row["error"]])
    return text.getvalue()


def as_text(sweep: Sweep) -> str:
    """A table for a terminal, and where the sheet is."""
    rows = [[*sweep.keys, "PSNR", "SSIM", "seconds", ""]]
    for row in (_facts(result) for result in sweep.results):
        numbers = [_short(row["psnr_db"], ".2f"), _short(row["ssim"], ".3f"), _short(row["seconds"], ".1f")]
        rows.append([*row["values"].values(), *numbers, row["error"] or ""])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines, "", f"{sweep.folder}: sweep.html, sweep.png, sweep.csv, sweep.json"])


def shown_by(manifest: Mapping[str, Any]) -> str | None:
    """The renderer whose pictures are compared: the reference if there, else the first; None if there is none."""
    renderers = list(manifest["views"][0]["renders"])
    return REFERENCE_RENDERER if REFERENCE_RENDERER in renderers else next(iter(renderers), None)


def scores(manifest: Mapping[str, Any]) -> dict[str, float | None]:
    """PSNR and SSIM of the compared renderer, means over the views; None where there is no number."""
    renderer = shown_by(manifest)
    suffix = "" if renderer in (REFERENCE_RENDERER, None) else f"_{renderer}"
    return {name: _mean([view.get(f"{name}{suffix}") for view in manifest["views"]]) for name in ("psnr_db", "ssim")}


def _facts(result: Result) -> dict[str, Any]:
    made = result.manifest
    numbers = {**scores(made), "seconds": made["seconds"]} if made else dict.fromkeys(("psnr_db", "ssim", "seconds"))
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
    known = [value for value in values if value is not None]
    return mean(known) if len(known) == len(values) else None
