"""The manifest of a run folder: its scene, stages, scores, versions, and a hash of every file."""

from __future__ import annotations

import hashlib
import io
import json
import math
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from itertools import compress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from magiclens.cache.store import file_digest
from magiclens.config.fields import Inputs
from magiclens.contract.artifacts import Scene, View
from magiclens.plan.compile import Plan, Step
from magiclens.running.folder import FORMAT, MANIFEST
from magiclens.running.replacing import atomic_file

if TYPE_CHECKING:
    from magiclens.images.score import Score, ScoresByRenderer

REFERENCE_RENDERER = "tracer"
"""Renderer whose scores are called ``psnr_db`` and ``ssim``; scores of other renderers carry the renderer's name."""

_LIBRARIES = ("magiclens", "numpy", "scipy", "numba", "trimesh", "pymeshlab", "mitsuba")
"""Packages whose versions can change a run's result."""


def source_path(view: View) -> str:
    """Path of the view's source in a run folder."""
    return f"sources/{view.source_name}.png"


def target_path(view: View) -> str:
    """Path of the view's target in a run folder."""
    return f"targets/{view.target_name}.png"


def render_path(renderer: str, view: View) -> str:
    """Path of a renderer's picture of the view in a run folder."""
    return f"renders/{renderer}/{view.name}.png"


def spec_text(plan: Plan, inputs: Inputs) -> str:
    """The resolved spec as YAML. Its files are named as copies in the run folder, and recorded in ``inputs``."""
    from ruamel.yaml import YAML

    yaml, text = YAML(), io.StringIO()
    yaml.width = 100  # characters, from which on ruamel breaks lines
    yaml.dump(plan.resolved(inputs), text)
    return text.getvalue()


def build_manifest(
    plan: Plan, inputs: Inputs, scene: Scene, metrics: Mapping[str, float], scores: ScoresByRenderer
) -> dict[str, Any]:
    """The manifest without timings and files: the part that is equal in equal runs.

    Args:
        plan: What was run.
        inputs: Files that the spec names; files that are new to it are added.
        scene: The scene as finished, with the sources of the encoder if there is one.
        metrics: Numbers by name; those that are not finite become null.
        scores: Of every renderer, one score per view.
    """
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
        "inputs": outside_inputs(plan, inputs),
        "spec_sha256": hashlib.sha256(spec_text(plan, inputs).encode()).hexdigest(),
    }


def outside_inputs(plan: Plan, inputs: Inputs) -> list[dict[str, str]]:
    """The files outside of the spec's folder: path as it was written, copy in the run folder, and hash.

    Files beside the spec are not listed: their copies are, and a run folder's own spec gives the same manifest again.

    Args:
        plan: What was run.
        inputs: Where the copies are; files that are new to it are added.
    """
    plan.resolved(inputs)  # which asks for the copies of all files that are used
    used = {path: copy for path, copy in inputs.items() if path in plan.outside}
    return [
        {"path": plan.outside[path], "copy": copy, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        for path, copy in used.items()
    ]


def write_manifest(folder: Path, manifest: Mapping[str, Any], seconds: Mapping[str, float]) -> dict[str, Any]:
    """Add timings and the list of files to a manifest, and write it.

    Args:
        folder: The run folder; all other files are in it already.
        manifest: What ``build_manifest`` returned.
        seconds: Durations by step name, and ``total``.

    Returns:
        The manifest as written.
    """
    # a stage whose result was in the cache has taken no time
    stages = [{**stage, "seconds": round(seconds.get(_name(stage), 0.0), 3)} for stage in manifest["stages"]]
    whole = {**manifest, "stages": stages, "artifacts": _files(folder, folder), "seconds": round(seconds["total"], 3)}
    _write(folder, whole)
    return whole


def refresh_manifest(folder: Path, *written: str) -> None:
    """List files that were added to a finished run folder, or changed, in its manifest.

    What the manifest says of other files stays: one that was damaged must not pass for whole from now on, and one that
    the user has put there must not be removed with the run.

    Args:
        folder: The run folder.
        written: Paths in it of files, and of folders with all that is in them now.
    """
    whole = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    new = [each for name in written for each in _files(folder, folder / name)]
    paths = (PurePosixPath(each["path"]) for each in whole["artifacts"])
    stays = [not any(path.is_relative_to(name) for name in written) for path in paths]
    old = compress(whole["artifacts"], stays)
    whole["artifacts"] = sorted([*old, *new], key=lambda artifact: Path(artifact["path"]))
    _write(folder, whole)


def _write(folder: Path, manifest: Mapping[str, Any]) -> None:
    with atomic_file(folder / MANIFEST) as path:
        # JSON has no NaN, which Python would write all the same; ``_number`` has replaced it
        path.write_text(json.dumps(manifest, indent=2, allow_nan=False) + "\n", encoding="utf-8")


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


def _view(view: View, index: int, scores: ScoresByRenderer) -> dict[str, Any]:
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
    }


def _number(value: float) -> float | None:
    """The number, or None where JSON has no number: NaN and infinity."""
    return float(value) if math.isfinite(value) else None


def versions(plan: Plan) -> dict[str, str]:
    """Versions of Python and of every package that can change the run's result."""
    plugins = [plan.scenario_plugin, *(step.plugin for step in plan.steps), *(each.plugin for each in plan.analyses)]
    known = {name: _version(name) for name in _LIBRARIES} | {plugin.package: plugin.version for plugin in plugins}
    return {"python": platform.python_version(), **{name: v for name, v in sorted(known.items()) if v}}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _files(folder: Path, within: Path) -> list[dict[str, Any]]:
    """Path, hash and size of a file of a run folder, or of all files in a folder but the manifest, sorted by path."""
    found = [within] if within.is_file() else within.rglob("*")
    paths = sorted(path for path in found if path.is_file() and path.name != MANIFEST)
    return [_file(path, path.relative_to(folder).as_posix()) for path in paths]


def _file(path: Path, name: str) -> dict[str, Any]:
    return {"path": name, "sha256": file_digest(path), "bytes": path.stat().st_size}
