"""Orders: what a user asks the studio for, and the spec with its pictures that it becomes."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field

from magiclens.contract.errors import InputError
from magiclens.studio.store import StudioFolder, file_below

if TYPE_CHECKING:
    from magiclens.plan.compile import Plan

SPEC = "spec.yaml"
"""Name of the spec in a job's folder."""
_DRAFT_FACETS, _DRAFT_MICROFACETS, _UNIVERSAL_MICROFACETS = 12, 8, 16


class Order(BaseModel):
    """What a user asks for: a scenario with pictures, or a spec as YAML."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenario: str = Field("single", max_length=40)
    pictures: list[str] = Field([], max_length=64)
    machine: str | None = Field(None, max_length=40)
    size: str = Field("60mm", max_length=20)
    yaml: str | None = Field(None, max_length=100_000)


def write_order(order: Order, store: StudioFolder, folder: Path) -> Plan:
    """Write the spec of an order, and copies of its pictures, into a folder, and check the spec.

    Raises:
        InputError: A picture is missing, or the spec has mistakes.
    """
    from magiclens.new.write import Making, new_spec
    from magiclens.plan.compile import load_plan
    from magiclens.running.feasible import require_feasible

    spec = folder / SPEC
    try:
        if order.yaml is None:
            pictures = [_copy(name, store, folder) for name in order.pictures]
            new_spec(order.scenario, pictures, spec, making=Making(order.machine, order.size))
        else:
            for name in named_pictures(order.yaml, store):
                _copy(name, store, folder)
            spec.write_text(order.yaml, encoding="utf-8")
        plan = load_plan(spec, sandbox=True)
        require_feasible(plan)
    except InputError as error:
        raise _without(folder, error) from None
    return plan


def fill_job(order: Order, store: StudioFolder, folder: Path) -> dict[str, Any]:
    """Write an order into the folder of a new job; what is to be known of the job. Raises like ``write_order``."""
    plan = write_order(order, store, folder)
    title = f"{plan.scenario.type}: {', '.join(path.stem for path in sorted(folder.glob('*.png')))}".rstrip(": ")
    return {"title": title, "state": "waiting", "want": "draft", "said": "", "draft": draft_settings(plan)}


def draft_settings(plan: Plan) -> list[str]:
    """What a draft changes in a spec, as ``--set`` takes it: few, coarse facets, and the built-in tracer alone."""
    universal = not plan.matcher.stage.uses_pictures
    microfacets = min(plan.lens.microfacets, _UNIVERSAL_MICROFACETS if universal else _DRAFT_MICROFACETS)
    return [
        f"lens.facets={min(plan.lens.facets, _DRAFT_FACETS)}",
        f"lens.microfacets={microfacets}",
        "pipeline.renderers=[{type: tracer}]",
    ]


def named_pictures(text: str, store: StudioFolder) -> list[str]:
    """The pictures of the studio whose names are in a text."""
    words = set(re.findall(r"[\w.-]+", text))
    return [name for name in store.pictures() if name in words]


def _copy(name: str, store: StudioFolder, folder: Path) -> Path:
    found = file_below(store.root / "pictures", name)
    if not found:
        raise InputError(f"there is no picture {name!r}; add it first")
    return Path(shutil.copyfile(found, folder / name))


def _without(folder: Path, error: InputError) -> InputError:
    """The error, its places and words without the path of a folder that nobody knows."""
    path = f"{folder}/"
    where = error.where and error.where.replace(path, "")
    others = tuple(_without(folder, each) for each in error.others)
    return InputError(error.message.replace(path, ""), where, error.keys, others)
