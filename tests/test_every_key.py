"""Another value of any key of a spec, of every scenario and stage there is: what a run then does again."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from keys import OTHER_MOVIE, OTHER_PICTURE, Key, all_keys
from magiclens.cache.store import Cache, Entry
from magiclens.config.document import document_of
from magiclens.contract.errors import InputError
from magiclens.plan.compile import Plan, compile_plan
from magiclens.plan.registry import SCENARIO, STAGE, Registry
from magiclens.running.forecast import forecast
from numeric import MOVIE, PICTURE

INSTALLED = Registry.load()
KEYS = list(all_keys(INSTALLED))
STEPS = [
    "matcher", "annealer", "integrator", "tracing", "finisher", "matrices", "encoder", "exporter", "renderer",
    "animations", "analyses",
]  # fmt: skip
"""Kinds of steps, each before what depends on it; only exporters are needed by nothing that follows."""


def since(kind: str) -> set[str]:
    """A kind of steps and all that depend on it."""
    return set(STEPS[STEPS.index(kind) :])


ALL = since("matcher")
DEPENDENT: dict[str, set[str]] = {
    "name": set(),
    "report": set(),
    "pipeline.matcher": ALL,
    "pipeline.annealer": since("annealer"),
    "pipeline.integrator": since("integrator"),
    "pipeline.finisher": since("finisher"),
    "pipeline.encoder": since("encoder"),
    "pipeline.exporters": {"exporter"},
    "pipeline.renderers": {"renderer", "analyses"},
    "scenario.camouflage": since("encoder"),
    "scenario.fps": {"animations", "analyses"},
    # analyses may ask the plan for anything about its machine
    "fabrication": {"analyses"},
    "fabrication.draft": since("integrator"),
    **dict.fromkeys(["fabrication.max_slope", "fabrication.wall"], ALL),
    **dict.fromkeys([f"fabrication.{key}" for key in ("blur", "polish", "lacquer")], ALL),
    "": ALL,
}
"""By the beginning of a key, the longest that fits: kinds of steps that depend on it."""
NO_PICTURES: dict[str, set[str]] = {
    "scenario.frames": since("finisher"),
    "scenario.frames.length": ALL,
    "scenario.source": since("finisher"),
    "scenario.pairs.0.answer": since("finisher"),
}
"""The same for lenses that are made before there are pictures. Where a question is depends on its picture."""
ONLY_ONE = {"scenario.frames.art"}
"""Keys that can have one value only."""


class Asked(Cache):
    """An empty cache that knows the keys that it was asked for."""

    def __init__(self, folder: Path):
        super().__init__(folder, 10**9)
        self.keys: list[str] = []

    def find(self, key: str) -> Entry | None:
        self.keys.append(key)
        return None


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures and films to choose from, wider than high, and no time for fine ones."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("magiclens.scenarios.pictures.TARGET_ART_PX", 32)
    pictures = []
    for k, name in enumerate((PICTURE, OTHER_PICTURE)):
        pixels = np.full((40, 60), 255, np.uint8)
        pixels[10:20, 10 + 20 * k : 30 + 20 * k] = 0
        pictures.append(Image.fromarray(pixels))
        pictures[-1].save(name)
    for name, frames in ((MOVIE, pictures), (OTHER_MOVIE, pictures[::-1])):
        frames[0].save(name, save_all=True, append_images=frames[1:])


def asked_for(plan: Plan, folder: Path) -> dict[str, list[str]]:
    """Keys of results by the kind of their step, in their order."""
    empty = Asked(folder)
    steps, found = forecast(plan, empty), {}
    analyses = {planned.analysis.name for planned in plan.analyses}
    for step, key in zip(steps, empty.keys, strict=True):
        kind = "analyses" if step.step in analyses else step.step.split()[0]
        found.setdefault(kind, []).append(f"{step.step} {key}")
    return found


def value_at(data: Any, path: str) -> Any:
    """What is at a path of a resolved spec; None if nothing is."""
    for word in path.split("."):
        try:
            data = data[int(word) if isinstance(data, list) else word]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def other_plan(key: Key, plan: Plan) -> Plan:
    """The plan with another value of a key."""
    resolved = plan.resolved()
    for text in key.others(value_at(resolved, key.path)):
        # all sources of pairs need the same size
        alike = [f"scenario.pairs.1.source.size={text}"] if key.path == "scenario.pairs.0.source.size" else []
        try:
            other = compile_plan(document_of(key.data, [*key.beside, *alike, f"{key.path}={text}"]), INSTALLED)
            other.shots()
        except InputError:
            continue
        if other.resolved() != resolved:
            return other
    raise AssertionError(f"no other value of {key.path} is allowed")


def dependent(key: Key, plan: Plan) -> set[str]:
    """Kinds of steps that depend on a key."""
    rules = DEPENDENT if plan.matcher.stage.uses_pictures else {**DEPENDENT, **NO_PICTURES}
    if key.path.endswith(".size"):  # of a source, to which every facet is aligned
        return ALL
    begins = (word for word in rules if f"{key.path}.".startswith(f"{word}." if word else ""))
    return rules[max(begins, key=len)]


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("step", [pytest.param(8, marks=pytest.mark.tools), pytest.param(1, marks=pytest.mark.sweep)])
def test_another_value_of_any_key_does_what_depends_on_it_and_nothing_else(step: int, tmp_path: Path) -> None:
    @cache
    def before(beside: tuple[str, ...], data: str) -> tuple[Plan, dict[str, list[str]]]:
        plan = compile_plan(document_of(datas[data], beside), INSTALLED)
        return plan, asked_for(plan, tmp_path)

    datas, wrong = {repr(key.data): key.data for key in KEYS}, []
    for key in KEYS[::step]:
        if key.path in ONLY_ONE:
            continue
        plan, old = before(key.beside, repr(key.data))
        other = other_plan(key, plan)
        new = asked_for(other, tmp_path)
        changed = {kind for kind, found in new.items() if not set(found) <= set(old.get(kind, ()))}
        odd = changed ^ (dependent(key, other) & new.keys())
        wrong += [f"{key.data['scenario']['type']}: {key.path}: {', '.join(sorted(odd))}"] if odd else []
    assert wrong == []


def test_keys_are_found_everywhere() -> None:
    paths = {key.path for key in KEYS}
    assert {"name", "lens.cells", "viewer.x", "medium.black", "pipeline.rematch", "report.analyses"} <= paths
    assert {"scenario.angles", "scenario.views.0.eye.tilt", "scenario.frames.movie", "scenario.margin"} <= paths
    assert {"pipeline.encoder.camouflage.circles.radius", "pipeline.exporters.0.cutter.tip_form"} <= paths
    assert {"fabrication.lacquer.wavelength", "fabrication.tilt.about", "fabrication.spindle"} <= paths
    assert len(KEYS) > 400


def test_every_stage_and_scenario_that_has_options_is_among_those() -> None:
    chosen = {key.data["scenario"]["type"] for key in KEYS}
    for key in KEYS:
        for each in key.data["pipeline"].values():
            chosen |= {choice["type"] for choice in (each if isinstance(each, list) else [each])}
    named = {key[-1] for key in INSTALLED.contributions if key[0] in (SCENARIO, STAGE)}
    assert named <= chosen
