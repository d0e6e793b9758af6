"""The machine that a spec names: its defaults for the lens and for stages, and what it cannot make."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from magiclens.config.checker import Checker
from magiclens.config.document import Document
from magiclens.config.model import AUTO, DEFAULT_SIZE, Choice, LensSpec
from magiclens.config.suggest import advice, unknown
from magiclens.contract.errors import InputError
from magiclens.contract.units import ANGLE, LENGTH
from magiclens.profiles.machines import Machine, Mill, Printer, Profile, machines, refused_machines

_KEY = "machine"


@dataclass(frozen=True)
class Fabrication:
    """The machine that makes a spec's lens.

    Attributes:
        name: The machine's name in the spec.
        profile: The machine as it is listed, with its defaults.
        machine: The machine with the spec's options laid over the listed ones.
    """

    name: str
    profile: Profile
    machine: Machine

    def lens(self, written: Mapping[str, Any]) -> dict[str, Any]:
        """The mapping at the key ``lens``: what is written there, laid over the machine's own defaults."""
        # a material and an ior together would be a mistake, so an ior that is written takes the material's place
        usual = {key: value for key, value in self.profile.lens.items() if key != "material" or not written.get("ior")}
        usual = {**self.machine.limits, **usual}
        # null in a spec counts as not written where the machine has a default
        lens = {**usual, **{key: value for key, value in written.items() if value is not None or key not in usual}}
        if lens.get("facets") == AUTO:
            with suppress(ValueError):  # a size that is none is reported later
                lens["facets"] = self.machine.facets_for(LENGTH.parse(lens.get("size", DEFAULT_SIZE)))
        return lens

    def suited(self, scenarios: Mapping[str, Choice], lens: LensSpec) -> dict[str, Choice]:
        """Stages that suit both scenario and machine; where they want different types, the scenario decides.

        Where both want a stage of one type, a mill's options hold, as it cannot make what they forbid, such as steps. A
        printer makes any heights: its options are advice, which a scenario may know better.

        Args:
            scenarios: Stages that suit the scenario, by kind.
            lens: The lens, on which some options of integrators depend, see ``Machine.integrator``.

        Returns:
            Types and options of stages, by kind.
        """
        own = {kind: dict(usual) for kind, usual in self.profile.stages.items()}
        if "integrator" in own:
            own["integrator"] |= self.machine.integrator(lens.wall, lens.cells)
        both: dict[str, Choice] = {**own, **scenarios}
        for kind, usual in own.items():
            if both[kind]["type"] == usual["type"]:
                first, last = (both[kind], usual) if isinstance(self.machine, Mill) else (usual, both[kind])
                both[kind] = {**first, **last}
        return both

    def resolved(self) -> dict[str, Any]:
        """The mapping at the key ``fabrication`` with every option."""
        return {_KEY: self.name, **self.machine.model_dump(mode="json", exclude_none=True)}

    def objections(self, lens: LensSpec) -> Iterator[tuple[str, str]]:
        """What the machine cannot make.

        Args:
            lens: The lens, as the spec and the machine's defaults have it.

        Yields:
            Keys of ``lens``, each with the reason.
        """
        machine = self.machine
        # the top may be a relief above its mean height, which is the lens's thickness, and a relief below it
        least, most = machine.thickness
        if lens.thickness + lens.relief > most:
            room = LENGTH.text(most - lens.relief)
            whole = f"a relief of {LENGTH.text(lens.relief)} makes it {LENGTH.text(lens.thickness + lens.relief)} high"
            yield "thickness", f"{whole}; {self.name} makes at most {LENGTH.text(most)}, so at most {room} here"
        if lens.thickness - lens.relief < least:
            thin = f"at its thinnest the lens would be {LENGTH.text(lens.thickness - lens.relief)}"
            yield "thickness", f"{thin}; {self.name} needs at least {LENGTH.text(least)}"
        if lens.max_slope > machine.max_slope:
            yield "max_slope", self._beyond(ANGLE.text(machine.max_slope), ANGLE.text(lens.max_slope), "most")
        if lens.wall < machine.wall:
            yield "wall", self._beyond(LENGTH.text(machine.wall), LENGTH.text(lens.wall), "least")
        if lens.size / lens.facets < machine.feature:
            # 30 mm / 0.3 mm is a little less than 100 in binary fractions
            fits = max(int(lens.size / machine.feature + 1e-9), 1)
            narrow = f"facets of {LENGTH.text(lens.size / lens.facets)}"
            yield "facets", f"{narrow} are below the {LENGTH.text(machine.feature)} of {self.name}; at most {fits} fit"
        widest = min(machine.bed[:2])  # the lens is square
        if lens.size > widest:
            yield "size", self._beyond(LENGTH.text(widest), LENGTH.text(lens.size), "most")
        if isinstance(machine, Mill):
            yield from self._out_of_reach(machine, lens)

    def _out_of_reach(self, machine: Mill, lens: LensSpec) -> Iterator[tuple[str, str]]:
        if lens.mark:
            yield "mark", f"{self.name} cuts the top alone, so it leaves no mark at the foot; nearest: false"
        if 2 * lens.relief > machine.reach:
            deep, half = LENGTH.text(2 * lens.relief), LENGTH.text(machine.reach / 2)
            reach = f"the cutter of {self.name} reaches {LENGTH.text(machine.reach)}"
            yield "relief", f"the top may be {deep} deep, {reach}; at most {half}"
        if lens.max_slope > machine.steepest_deg:
            yield "max_slope", self._beyond(ANGLE.text(machine.steepest_deg), ANGLE.text(lens.max_slope), "most")

    def _beyond(self, limit: str, got: str, side: str) -> str:
        return f"{self.name} can do {limit} at {side}, got {got}"


def find_fabrication(document: Document, checker: Checker) -> Fabrication | None:
    """The machine that a spec names; None if it names none, or if there are mistakes, which are then noted."""
    written = document.data.get("fabrication")
    if not isinstance(written, dict):
        return None
    known, name = machines(), written.get(_KEY)
    if name is None:
        checker.add(("fabrication", _KEY), f"this key is required; {advice('', known)}")
        return None
    profile = known.get(str(name))
    if profile is None:
        checker.add(("fabrication", _KEY), _why_unlisted(str(name)))
        return None
    options = {key: value for key, value in written.items() if key != _KEY}
    if profile.model is Printer and _writes_slices(document, profile):
        options = {"slicing": "diffused", **options}
    machine = checker.validate(profile.model, {**profile.options, **options}, ("fabrication",))
    return Fabrication(str(name), profile, machine) if machine else None


def listed_machine(name: str, where: str) -> Profile:
    """The machine of that name. Raises InputError, which names ``where``, if there is none, or none that can do it."""
    if name not in machines():
        raise InputError(_why_unlisted(name), where)
    return machines()[name]


def _why_unlisted(name: str) -> str:
    return refused_machines().get(name) or unknown("machine", name, machines())


def _writes_slices(document: Document, profile: Profile) -> bool:
    """Whether the spec exports slices of its own, whose rounding is ours; otherwise somebody else's slicer rounds."""
    pipeline = document.data.get("pipeline")
    exporters = pipeline.get("exporters", profile.exporters) if isinstance(pipeline, dict) else profile.exporters
    named = exporters if isinstance(exporters, list) else []
    ours = [*profile.machine().exporters()]  # a list, since what is written as a type may be unhashable
    return any(isinstance(each, dict) and each.get("type") in ours for each in named)
