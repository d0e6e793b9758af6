"""How a spec's lens is made: the machine that it names, and what that machine cannot do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from magiclens.config.checker import Checker
from magiclens.config.document import Document
from magiclens.config.model import Choice, LensSpec
from magiclens.config.suggest import advice, unknown
from magiclens.contract.units import ANGLE, LENGTH
from magiclens.profiles.machines import Machine, Mill, Profile, machines

KEY = "machine"


@dataclass(frozen=True)
class Fabrication:
    """The machine that a spec names, its options laid over the listed ones."""

    name: str
    profile: Profile
    machine: Machine

    def lens(self, written: Mapping[str, Any]) -> dict[str, Any]:
        """The mapping at ``lens`` with the machine's own defaults below what is written."""
        usual = {key: value for key, value in self.profile.lens.items() if key != "material" or not written.get("ior")}
        usual = {**self.machine.limits, **usual}
        return {**usual, **{key: value for key, value in written.items() if value is not None or key not in usual}}

    def suited(self, scenarios: Mapping[str, Choice], wall_mm: float) -> dict[str, Choice]:
        """Stages, by kind, that suit scenario and machine; where they want different types, the scenario's."""
        own = {kind: dict(usual) for kind, usual in self.profile.stages.items()}
        if isinstance(self.machine, Mill) and "integrator" in own:
            own["integrator"]["step_limit"] = LENGTH.text(round(self.machine.step_mm(wall_mm), 4))
        both: dict[str, Choice] = {**own, **scenarios}
        for kind, usual in own.items():
            if both[kind]["type"] == usual["type"]:
                both[kind] = {**both[kind], **usual}
        return both

    def resolved(self) -> dict[str, Any]:
        """The mapping at ``fabrication``, every option explicit."""
        return {KEY: self.name, **self.machine.model_dump(mode="json", exclude_none=True)}

    def objections(self, lens: LensSpec) -> Iterator[tuple[str, str]]:
        """What the machine cannot do: the key under ``lens``, and why."""
        able = self.machine
        least, most = able.thickness
        if lens.thickness + lens.relief > most:
            room = LENGTH.text(most - lens.relief)
            whole = f"a relief of {LENGTH.text(lens.relief)} makes it {LENGTH.text(lens.thickness + lens.relief)} high"
            yield "thickness", f"{whole}; {self.name} makes at most {LENGTH.text(most)}, so at most {room} here"
        if lens.thickness - lens.relief < least:
            thin = f"at its thinnest the lens would be {LENGTH.text(lens.thickness - lens.relief)}"
            yield "thickness", f"{thin}; {self.name} needs at least {LENGTH.text(least)}"
        if lens.max_slope > able.max_slope:
            yield "max_slope", self._beyond(ANGLE.text(able.max_slope), ANGLE.text(lens.max_slope), "most")
        if lens.wall < able.wall:
            yield "wall", self._beyond(LENGTH.text(able.wall), LENGTH.text(lens.wall), "least")
        if lens.size / lens.facets < able.feature:
            fits = max(int(lens.size / able.feature + 1e-9), 1)
            narrow = f"facets of {LENGTH.text(lens.size / lens.facets)}"
            yield "facets", f"{narrow} are below the {LENGTH.text(able.feature)} of {self.name}; at most {fits} fit"
        if lens.size > max(able.bed[:2]) or lens.size > min(able.bed[:2]):
            yield "size", self._beyond(LENGTH.text(min(able.bed[:2])), LENGTH.text(lens.size), "most")
        if isinstance(able, Mill):
            yield from self._out_of_reach(able, lens)

    def _out_of_reach(self, able: Mill, lens: LensSpec) -> Iterator[tuple[str, str]]:
        if 2 * lens.relief > able.reach:
            deep, half = LENGTH.text(2 * lens.relief), LENGTH.text(able.reach / 2)
            reach = f"the cutter of {self.name} reaches {LENGTH.text(able.reach)}"
            yield "relief", f"the top may be {deep} deep, {reach}; at most {half}"
        if lens.max_slope > able.steepest_deg:
            yield "max_slope", self._beyond(ANGLE.text(able.steepest_deg), ANGLE.text(lens.max_slope), "most")

    def _beyond(self, limit: str, got: str, side: str) -> str:
        return f"{self.name} can do {limit} at {side}, got {got}"


def find_fabrication(document: Document, checker: Checker) -> Fabrication | None:
    """The machine at ``fabrication``; None if there is none, or something is wrong with it."""
    written = document.data.get("fabrication")
    if not isinstance(written, dict):
        return None
    known, name = machines(), written.get(KEY)
    if name is None:
        checker.add(("fabrication", KEY), f"this key is required; {advice('', known)}")
        return None
    profile = known.get(str(name))
    if profile is None:
        checker.add(("fabrication", KEY), unknown("machine", name, known))
        return None
    options = {key: value for key, value in written.items() if key != KEY}
    machine = checker.validate(profile.model, {**profile.options, **options}, ("fabrication",))
    return Fabrication(str(name), profile, machine) if machine else None
