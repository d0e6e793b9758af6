"""Every numeric option of a spec, found from the schemas of its scenarios and stages, and bad values for each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from magiclens.config.model import LISTED_STAGES, Spec
from magiclens.plan.registry import SCENARIO, STAGE, Registry
from magiclens.profiles.machines import machines

BAD = ("0", "-1", "1e-9", "1e12", ".nan", ".inf", "1e308", "-1e-9")
"""Nothing, less than nothing, and far too little or much of it, as YAML writes them."""

UNITS = {"|mm/s|": "mm/min", "|cm|": "mm", "(deg|": "deg", "(%)": "%"}
"""Parts of the patterns of quantities, and the unit that is written for them."""

PICTURE = "picture.png"
"""A file that must be there."""

MOVIE = "film.gif"
"""Another one."""

SAMPLES = {"text": "abc", "name": "panda", "art": "panda", "path": PICTURE, "image": PICTURE}
"""Values of keys that something which is chosen by its ``type`` requires."""

PICTURES: dict[str, Any] = {"source": {"type": "circles"}, "target": {"art": "panda"}}
SCENARIOS: dict[str, dict[str, Any]] = {
    "single": PICTURES,
    "rotating": {"source": {"type": "circles"}, "targets": [{"art": "panda"}, {"art": "bat"}]},
    "multi-pair": {"pairs": [PICTURES, {"source": {"type": "plain"}, "target": {"art": "bat"}}]},
    "multi-view": {
        "source": {"type": "circles"},
        "views": [
            {"target": {"art": "panda"}, "eye": {"x": "0mm", "y": "0mm"}},
            {"target": {"art": "bat"}, "eye": {"tilt": "5deg", "azimuth": "0deg"}},
        ],
    },
    "stable-zone": PICTURES,
    "universal-animation": {"frames": {"art": "worm", "length": 2}},
    "question-answer": {"pairs": [{"question": {"type": "text", "text": "6 x 7"}, "answer": {"text": "42"}}]},
}
"""The least that each scenario needs."""


_REQUIRED: dict[str, dict[str, Any]] = {"monitor": {"ppi": 100}, "dart-throwing": {"reach": "100%"}}
"""Options of stages that have no default, or one that does not fit a tiny lens."""

MACHINES = {
    "printing": "{machine: printing, lacquer: {film: 20um}, grey: {bits: 4}, tilt: {angle: 10deg},"
    " cure: {penetration: 0.2mm, critical: 10, exposure: 25}}",
    "milling": "{machine: milling}",
}
"""One machine of each process, with the options that are left out by default."""
_INSTEAD = {
    "lacquer.wavelength": "{wavelength: 1mm}",
    **{f"cutter.{key}": "{shape: v, diameter: 3mm}" for key in ("tip", "tip_form", "angle")},
    **{f"rougher.{key}": "{shape: v, diameter: 3mm}" for key in ("tip", "tip_form", "angle")},
    **{f"eye.{key}": "{tilt: 5deg, azimuth: 10deg}" for key in ("tilt", "azimuth")},
    **{f"{what}.{key}": f"{{{key}: {SAMPLES[key]}}}" for what in ("target", "0", "answer") for key in
       ("image", "art", "text")},
    **{f"{what}.fit": f"{{image: {PICTURE}}}" for what in ("target", "0", "answer")},
    "frames.fit": f"{{images: [{PICTURE}, {PICTURE}]}}",
    "frames.images": f"{{images: [{PICTURE}, {PICTURE}]}}",
    "frames.movie": f"{{movie: {MOVIE}}}",
}  # fmt: skip
"""What makes the place for options that others exclude, by the end of the path."""


@dataclass(frozen=True)
class Part:
    """A part of a spec that has options of its own.

    Attributes:
        data: Of a tiny lens that has this part.
        at: Its path in there.
        schema: Of its model, as JSON Schema.
        beside: ``--set`` texts that complete the spec.
    """

    data: dict[str, Any]
    at: str
    schema: Mapping[str, Any]
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class NumericOption:
    """One number that a spec may hold, and a spec to write it in.

    Attributes:
        path: Of the number, from the top of the spec.
        unit: What follows the number, such as ``mm``.
        items: How many numbers fill the list that it is; 0 if it is none.
        beside: ``--set`` texts that make the place for it.
    """

    path: str
    unit: str = ""
    items: int = 0
    beside: tuple[str, ...] = ()

    def override(self, value: str) -> str:
        """The ``--set`` text that gives it a value; a list is filled with it."""
        number = value + self.unit
        return f"{self.path}=" + (f"[{', '.join([number] * self.items)}]" if self.items else number)


def all_numeric_options(registry: Registry) -> Iterator[tuple[dict[str, Any], NumericOption]]:
    """Every number of every scenario, stage and other part of a spec, with the data of a spec that may hold it."""
    seen = set()
    for part in parts(registry):
        for option in numeric_options(part.schema, part.at):
            # one and the same model, such as that of random discs, is part of many scenarios
            model = option.beside and (option.beside[-1].partition("=")[2], option.path.rpartition(".")[2])
            if not (part.at == "scenario" and model and model in seen):
                yield part.data, replace(option, beside=(*part.beside, *option.beside, *instead(option.path)))
            seen.add(model)


def parts(registry: Registry) -> Iterator[Part]:
    """Every scenario, stage and machine, and what is left of a spec."""
    for type_, scenario in registry.classes(SCENARIO).items():
        yield Part(spec_of(type_), "scenario", scenario.model_json_schema())
    lists = {kind: key for key, kind in LISTED_STAGES.items()}
    for _, kind, type_ in (key for key in registry.contributions if key[0] == STAGE):
        choice = {"type": type_, **_REQUIRED.get(type_, {})}
        chosen: dict[str, Any] = {lists[kind]: [choice]} if kind in lists else {kind: choice}
        data = {**spec_of("universal-animation" if type_ == "dart-throwing" else "single"), "pipeline": chosen}
        at = f"pipeline.{lists[kind]}.0" if kind in lists else f"pipeline.{kind}"
        yield Part(data, at, registry.classes(STAGE, kind)[type_].model_json_schema())
    for name, choice in MACHINES.items():
        schema = machines()[name].model.model_json_schema()
        # an exporter without options: those that machines have by default take theirs from the machine
        beside = (f"fabrication={choice}", "pipeline.exporters=[{type: stl}]")
        yield Part(spec_of("single"), "fabrication", schema, beside)
    yield Part(spec_of("single"), "", Spec.model_json_schema())


def instead(path: str) -> tuple[str, ...]:
    """The ``--set`` text that makes the place for an option that others exclude."""
    above, _, key = path.rpartition(".")
    other = _INSTEAD.get(f"{above.rpartition('.')[2]}.{key}")
    return (f"{above}={other}",) if other else ()


def spec_of(scenario: str) -> dict[str, Any]:
    """The data of a tiny lens."""
    lens = {"size": "20mm", "facets": 4, "microfacets": 3, "thickness": "20mm", "relief": "8mm"}
    universal = scenario in ("universal-animation", "question-answer")
    pipeline = {"matcher": {"type": "dart-throwing", **_REQUIRED["dart-throwing"]}} if universal else {}
    return {"name": "tiny", "scenario": {"type": scenario, **SCENARIOS[scenario]}, "lens": lens, "pipeline": pipeline}


def numeric_options(schema: Mapping[str, Any], at: str) -> Iterator[NumericOption]:
    """All numbers in the JSON Schema of a model that is written at a path."""
    definitions = schema.get("$defs", {})

    def walk(node: Mapping[str, Any], here: NumericOption, seen: tuple[str, ...]) -> Iterator[NumericOption]:
        name = str(node.get("$ref", "")).rpartition("/")[2]
        if name and name not in seen:
            found = definitions[name]
            yield from walk(found, replace(here, beside=(*here.beside, *chosen_type(found, here.path))), (*seen, name))
        for choice in (*node.get("anyOf", ()), *node.get("oneOf", ())):
            yield from walk(choice, here, seen)
        for key, child in node.get("properties", {}).items():
            yield from walk(child, replace(here, path=f"{here.path}.{key}".lstrip(".")), seen)
        if node.get("type") == "array":
            items = node.get("items") or node.get("prefixItems", [{}])[0]
            least = node.get("minItems") or len(node.get("prefixItems", ())) or 1
            numbers = (found for found in walk(items, here, seen) if found.path == here.path)
            yield from (replace(found, items=least) for found in numbers)
            first = replace(here, path=f"{here.path}.0")
            yield from (found for found in walk(items, first, seen) if found.path != first.path)
        elif node.get("type") in ("integer", "number"):
            yield here
        elif unit := unit_of(node):
            yield replace(here, unit=unit)

    yield from dict.fromkeys(walk(schema, NumericOption(at), ()))


def chosen_type(model: Mapping[str, Any], path: str) -> tuple[str, ...]:
    """The ``--set`` that chooses a model by its ``type``, with what it requires besides; nothing if it has no type."""
    type_ = model.get("properties", {}).get("type", {}).get("const")
    needs = [key for key in model.get("required", ()) if key in SAMPLES]
    return (f"{path}={{type: {type_}, {', '.join(f'{key}: {SAMPLES[key]}' for key in needs)}}}",) if type_ else ()


def unit_of(node: Mapping[str, Any]) -> str:
    """The unit in which a quantity is written; empty for other values."""
    pattern = node.get("pattern", "") if node.get("type") == "string" else ""
    return next((unit for part, unit in UNITS.items() if part in pattern), "")
