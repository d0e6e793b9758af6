"""Runs as jobs: small picklable values that an executor carries out in this process, in another, or elsewhere."""

from __future__ import annotations

import hashlib
import io
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
from magiclens.plan.blame import blaming
from magiclens.plan.compile import Plan, load_plan
from magiclens.plan.registry import EXECUTOR, Registry
from magiclens.running.manifest import spec_text, versions
from magiclens.running.pipeline import kept_run, write_run
from magiclens.running.run_files import verified


@dataclass(frozen=True)
class RunJob:
    """One run to do. Paths are text, and those of the machine that does the job.

    Attributes:
        spec: The spec file.
        overrides: ``key.path=value`` texts that are laid over it.
        out: The run folder to write.
    """

    spec: str
    overrides: tuple[str, ...]
    out: str


def run_job(job: RunJob, registry: Registry | None = None) -> dict[str, Any]:
    """Do a run, unless its run folder is up to date, and return its manifest. Raises like ``write_run``."""
    plan = load_plan(job.spec, job.overrides, registry)
    return finished_manifest(plan, Path(job.out)) or kept_run(plan, job.out) or write_run(plan, job.out)


def finished_manifest(plan: Plan, folder: Path) -> dict[str, Any] | None:
    """The manifest of a run folder that is up to date; None if the plan has to be run (again).

    A run folder is up to date if it has the plan's spec, input files, stages and versions, and all of its files.
    """
    try:
        files = verified(folder)
        files.check_files()
    except InputError:  # there is none, or it has been damaged
        return None
    found = files.manifest
    inputs = Inputs()
    spec = hashlib.sha256(spec_text(plan, inputs).encode()).hexdigest()
    stages = [(step.stage.type, step.stage.version) for step in plan.steps]
    known = [(stage["type"], stage["version"]) for stage in found["stages"]]
    same = (spec, versions(plan), stages) == (found["spec_sha256"], found["versions"], known)
    return found if same and _same_inputs(inputs, found) else None


def _same_inputs(inputs: Inputs, manifest: dict[str, Any]) -> bool:
    """Whether the run used these very files, by their hashes."""
    hashes = {artifact["path"]: artifact["sha256"] for artifact in manifest["artifacts"]}
    return all(hashes.get(kept) == hashlib.sha256(path.read_bytes()).hexdigest() for path, kept in inputs.items())


def choose_executor(name: str, settings: Iterable[str], registry: Registry) -> Executor:
    """The executor of that name with its options.

    Args:
        name: The executor's ``type``.
        settings: Options as ``key=value``; values are YAML.
        registry: Where executors are found.

    Raises:
        InputError: There is no such executor or option; the message names the nearest choice.
    """
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
