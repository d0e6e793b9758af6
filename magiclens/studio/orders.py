"""Orders: what a user asks the studio for, and the spec with its pictures that it becomes."""

from __future__ import annotations

import io
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

from pydantic import BaseModel, ConfigDict, Field

from magiclens.contract.errors import InputError
from magiclens.exporting.archive import entry
from magiclens.pages.pictures import webp_uri
from magiclens.studio.store import StudioFolder, file_below

if TYPE_CHECKING:
    from magiclens.new.assess import Treatment
    from magiclens.plan.compile import Plan

SPEC = "spec.yaml"
"""Name of the spec in a job's folder."""
PACKED = "spec.zip"
"""The name under which the spec is served with its pictures."""
_PREVIEW_PX = 384
_DRAFT_FACETS, _DRAFT_MICROFACETS, _UNIVERSAL_MICROFACETS = 12, 8, 16


class Order(BaseModel):
    """What a user asks for: a scenario with pictures, or a spec as YAML."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenario: str = Field("single", max_length=40)
    pictures: list[str] = Field([], max_length=64)
    machine: str | None = Field(None, max_length=40)
    size: str = Field("60mm", max_length=20)
    facets: int | None = Field(None, ge=2, le=256)
    thickness: str | None = Field(None, max_length=20)
    paper: str = Field("auto", max_length=10, pattern="^[a-z0-9]+$")
    jig: bool = False
    crop: str = Field("auto", max_length=10)
    contrast: float = Field(0.0, ge=0, lt=1)
    ground: str = Field("auto", max_length=10)
    yaml: str | None = Field(None, max_length=100_000)


def write_order(order: Order, store: StudioFolder, folder: Path) -> Plan:
    """Write the spec of an order, and copies of its pictures, into a folder, and check the spec.

    Raises:
        InputError: A picture is missing, or the spec has mistakes.
    """
    from magiclens.new.write import Making, new_spec, treatment_of
    from magiclens.plan.compile import load_plan
    from magiclens.running.feasible import require_feasible

    spec = folder / SPEC
    try:
        if order.yaml is None:
            pictures = [_copy(name, store, folder) for name in order.pictures]
            making = Making(order.machine, order.size, "table", order.facets, order.thickness, order.paper, order.jig)
            treatment = treatment_of(order.crop, order.contrast, order.ground)
            new_spec(order.scenario, pictures, spec, making=making, treatment=treatment)
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
    from magiclens.new.layouts import LAYOUTS
    from magiclens.plan.compile import load_plan
    from magiclens.running.estimate import estimate

    plan = write_order(order, store, folder)
    names = ", ".join(path.stem for path in sorted(folder.glob("*.png")))
    kind = LAYOUTS[plan.scenario.type].title if plan.scenario.type in LAYOUTS else plan.scenario.type
    title = f"{names}: {kind}" if names else kind
    draft = draft_settings(plan)
    # the draft is measured, and says with this how long the full design takes on this machine
    full_by_draft = estimate(plan).seconds / estimate(load_plan(folder / SPEC, draft, sandbox=True)).seconds
    known = {"facets": plan.lens.facets, "full_by_draft": full_by_draft, "draft": draft}
    return {"title": title, "state": "waiting", "want": "draft", "said": "", **known}


def draft_settings(plan: Plan) -> list[str]:
    """What a draft changes in a spec, as ``--set`` takes it: few, coarse facets, and only what its verdict needs."""
    universal = not plan.matcher.stage.uses_pictures
    microfacets = min(plan.lens.microfacets, _UNIVERSAL_MICROFACETS if universal else _DRAFT_MICROFACETS)
    return [
        f"lens.facets={min(plan.lens.facets, _DRAFT_FACETS)}",
        f"lens.microfacets={microfacets}",
        "pipeline.renderers=[{type: tracer, resolution: 256}]",
        "pipeline.exporters=[{type: 3mf}]",
        "report.analyses=[as-made]",
    ]


def previewed(name: str, treatment: Treatment, store: StudioFolder) -> dict[str, Any]:
    """A picture as a spec would show it: a small data URI, and sentences on what is done to it.

    Raises:
        InputError: There is no such picture, or it shows next to nothing.
    """
    from magiclens.drawing.tiles import to_pixels
    from magiclens.images import read_image
    from magiclens.new.assess import assess

    found = file_below(store.root / "pictures", name)
    if not found:
        raise InputError(f"there is no picture {name!r}; add it first")
    try:
        assessed = assess(found, treatment)
    except InputError as error:
        raise _without(found.parent, error) from None
    picture = to_pixels(assessed.shown(read_image(found), _PREVIEW_PX), _PREVIEW_PX)
    return {"picture": webp_uri(picture), "reasons": assessed.reasons}


def packed_order(folder: Path) -> bytes:
    """A zip file with the spec of a job and its pictures, which ``mlens run`` takes when it is unpacked."""
    content = io.BytesIO()
    with ZipFile(content, "w") as archive:
        for path in (folder / SPEC, *sorted(folder.glob("*.png"))):
            archive.writestr(entry(path.name), path.read_bytes())
    return content.getvalue()


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
