"""Runs as tasks: plain things that any executor can carry out, in this process or far away, again if need be."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from magiclens.config.document import child
from magiclens.config.fields import Inputs
from magiclens.config.suggest import unknown
from magiclens.config.wording import sentence
from magiclens.contract.errors import InputError
from magiclens.contract.executors import Executor
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.registry import EXECUTOR, Registry, blaming
from magiclens.running.folder import MANIFEST
from magiclens.running.manifest import spec_text, versions
from magiclens.running.pipeline import run_plan


@dataclass(frozen=True)
class Task:
    """One run: a spec file, what is laid over it, and the run folder to write. Both paths hold where it is done."""

    spec: str
    overrides: tuple[str, ...]
    out: str


def make(task: Task, registry: Registry | None = None) -> dict[str, Any]:
    """The manifest of the run folder, made unless it is there already. Raises like ``run_plan``."""
    plan = load_plan(task.spec, task.overrides, registry)
    return finished(plan, Path(task.out)) or run_plan(plan, task.out).manifest


def finished(plan: Plan, folder: Path) -> dict[str, Any] | None:
    """The manifest of a run folder that running the plan would only write again; None if there is no such folder.

    It has the same spec, input files, stages and versions of everything, and still all of its files.
    """
    if not (folder / MANIFEST).is_file():
        return None
    found: dict[str, Any] = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    inputs = Inputs()
    spec = hashlib.sha256(spec_text(plan, inputs).encode()).hexdigest()
    stages = [(step.stage.type, step.stage.version) for step in plan.steps]
    known = [(stage["type"], stage["version"]) for stage in found["stages"]]
    same = (spec, versions(plan), stages) == (found["spec_sha256"], found["versions"], known)
    return found if same and _has_files(folder, found) and _used(inputs, found) else None


def _has_files(folder: Path, manifest: dict[str, Any]) -> bool:
    return all((folder / artifact["path"]).is_file() for artifact in manifest["artifacts"])


def _used(inputs: Inputs, manifest: dict[str, Any]) -> bool:
    """Whether these files were the run's inputs, byte by byte."""
    hashes = {artifact["path"]: artifact["sha256"] for artifact in manifest["artifacts"]}
    return all(hashes.get(kept) == hashlib.sha256(path.read_bytes()).hexdigest() for path, kept in inputs.items())


def choose_executor(name: str, settings: Iterable[str], registry: Registry) -> Executor:
    """The executor of that name with ``key=value`` options. Raises InputError with the nearest choice."""
    found = registry.find(EXECUTOR, name)
    if found is None:
        raise InputError(unknown("executor", name, registry.types(EXECUTOR)), "--executor")
    options = dict(_option(text) for text in settings)
    with blaming(f"executor {name} ({found[1]})"):
        try:
            executor: Executor = found[0].model_validate(options)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = str(first["loc"][0]) if first["loc"] else ""
            message = sentence(first, child(options, key), found[0], "option")
            raise InputError(f"{key}: {message}", f"--executor {name}") from None
        return executor


def _option(text: str) -> tuple[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise InputError("write key=value, such as workers=2", f"--executor-set {text}")
    try:
        return key.strip(), YAML(typ="safe").load(io.StringIO(value))
    except YAMLError:
        raise InputError(f"'{value}' is not a value that YAML can read", f"--executor-set {text}") from None
