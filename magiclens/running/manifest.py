"""The manifest: what a run made, from what, how well, and the proof of it."""

from __future__ import annotations

import hashlib
import io
import json
import math
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magiclens.config.fields import Inputs
from magiclens.contract.artifacts import Scene, View
from magiclens.plan.compile import Plan, Step
from magiclens.running.folder import MANIFEST

if TYPE_CHECKING:
    from magiclens.images.score import Score

FORMAT = 1
REFERENCE_RENDERER = "tracer"
"""Its scores are ``psnr_db`` and ``ssim``; those of other renderers carry the renderer's name."""

LIBRARIES = ("magiclens", "numpy", "scipy", "numba", "trimesh", "pymeshlab", "mitsuba")
"""Whose versions can change a run's result."""

Scores = Mapping[str, list["Score"]]
"""By renderer type, one score per view."""


def source_path(view: View) -> str:
    """Where a run folder keeps the view's source."""
    return f"sources/{view.source_name}.png"


def target_path(view: View) -> str:
    """Where a run folder keeps the view's target."""
    return f"targets/{view.target_name}.png"


def render_path(renderer: str, view: View) -> str:
    """Where a run folder keeps what a renderer saw."""
    return f"renders/{renderer}/{view.name}.png"


def spec_text(plan: Plan, inputs: Inputs) -> str:
    """The resolved spec as YAML; its files are where ``inputs`` puts them."""
    from ruamel.yaml import YAML

    yaml, text = YAML(), io.StringIO()
    yaml.width = 100
    yaml.dump(plan.resolved(inputs), text)
    return text.getvalue()


def manifest(plan: Plan, inputs: Inputs, scene: Scene, metrics: Mapping[str, float], scores: Scores) -> dict[str, Any]:
    """Everything that is equal in equal runs, but for the list of files."""
    return {
        "format": FORMAT,
        "name": plan.spec.name,
        "scenario": plan.scenario.type,
        "scene": _scene(scene),
        "views": [_view(view, i, scores) for i, view in enumerate(scene.views)],
        "stages": [_stage(step, inputs) for step in plan.steps],
        "metrics": {name: _number(value) for name, value in metrics.items()},
        "seed": plan.spec.seed,
        "versions": versions(plan),
        "spec_sha256": hashlib.sha256(spec_text(plan, inputs).encode()).hexdigest(),
    }


def write_manifest(folder: Path, facts: Mapping[str, Any], seconds: Mapping[str, float]) -> dict[str, Any]:
    """Complete the manifest with timings (by step name, and ``total``) and files, and write it."""
    stages = [{**stage, "seconds": round(seconds[_name(stage)], 3)} for stage in facts["stages"]]
    whole = {**facts, "stages": stages, "artifacts": _files(folder), "seconds": round(seconds["total"], 3)}
    (folder / MANIFEST).write_text(json.dumps(whole, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return whole


def refresh_manifest(folder: Path) -> None:
    """List the files of a finished run folder anew, after some have been written again."""
    whole = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    whole["artifacts"] = _files(folder)
    (folder / MANIFEST).write_text(json.dumps(whole, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _name(stage: Mapping[str, Any]) -> str:
    return f"{stage['kind']} {stage['type']}"


def _scene(scene: Scene) -> dict[str, Any]:
    lens = scene.lens
    return {
        "size_mm": lens.size_mm,
        "source_size_mm": lens.source_size_mm,
        "thickness_mm": lens.thickness_mm,
        "gap_mm": lens.gap_mm,
        "ior": lens.ior,
        "facets": lens.facets,
        "microfacets": lens.microfacets,
        "cells": lens.cells,
    }


def _view(view: View, index: int, scores: Scores) -> dict[str, Any]:
    found: dict[str, float | None] = {"psnr_db": None, "ssim": None}
    for renderer, of_views in scores.items():
        found |= _score(renderer, of_views[index])
    return {
        "name": view.name,
        "eye_mm": [float(x) for x in view.eye_mm],
        "rotation_deg": view.rotation_deg,
        "source": source_path(view),
        "target": target_path(view),
        "renders": {renderer: render_path(renderer, view) for renderer in scores},
        **found,
    }


def _score(renderer: str, found: Score) -> dict[str, float | None]:
    suffix = "" if renderer == REFERENCE_RENDERER else f"_{renderer}"
    return {f"psnr_db{suffix}": _number(round(found.psnr_db, 4)), f"ssim{suffix}": _number(round(found.ssim, 5))}


def _stage(step: Step[Any], inputs: Inputs) -> dict[str, Any]:
    options = {key: value for key, value in step.choice(inputs).items() if key != "type"}
    return {
        "kind": step.stage.kind,
        "type": step.stage.type,
        "version": step.stage.version,
        "plugin": step.plugin.package,
        "options": options,
        "cached": False,
    }


def _number(value: float) -> float | None:
    """JSON has no NaN."""
    return float(value) if math.isfinite(value) else None


def versions(plan: Plan) -> dict[str, str]:
    """Of Python, and of every package that can change the run's result."""
    known = {name: _version(name) for name in LIBRARIES} | {s.plugin.package: s.plugin.version for s in plan.steps}
    return {"python": platform.python_version(), **{name: v for name, v in sorted(known.items()) if v}}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _files(folder: Path) -> list[dict[str, Any]]:
    """Every file of a run folder with its hash, in a fixed order."""
    paths: Iterable[Path] = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != MANIFEST)
    return [_file(path, path.relative_to(folder).as_posix()) for path in paths]


def _file(path: Path, name: str) -> dict[str, Any]:
    content = path.read_bytes()
    return {"path": name, "sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
