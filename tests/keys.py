"""Every key of a spec, found from the schemas of its scenarios and stages, and other values for each."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from magiclens.plan.registry import Registry
from numeric import PICTURE, SAMPLES, chosen_type, instead, parts, unit_of

_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")
_FACTORS = (1.1, 0.9, 2, 0.5, -1)
OTHER_PICTURE, OTHER_MOVIE = "other.png", "other.gif"
"""Files that must be there, too, beside those of ``numeric``."""
_OTHERS = {
    "growth": ["[[0.4, 0], [1, 1]]"], "feed": ["600mm/min"], "plunge": ["200mm/min"], "analyses": ["[]"],
    "samples": ["16", "256"], "images": [f"[{PICTURE}, {OTHER_PICTURE}]"], "movie": [OTHER_MOVIE],
    "levels": ["[10%, 90%]"], "tip": ["0.1mm"], "angle": ["40deg"], "fit": ["crop"],
}  # fmt: skip
"""Values that schemas do not tell, by the last word of the key."""


@dataclass(frozen=True)
class Key:
    """A key of a spec, and a spec to write it in.

    Attributes:
        path: From the top of the spec.
        data: The spec without it.
        nodes: JSON Schemas of what it may be.
        beside: ``--set`` texts that make the place for it.
    """

    path: str
    data: Mapping[str, Any]
    nodes: tuple[Mapping[str, Any], ...] = ()
    beside: tuple[str, ...] = ()

    def others(self, value: Any) -> Iterator[str]:
        """Texts of values that it may have instead of one; most of them are allowed."""
        yield from _OTHERS.get(self.path.rpartition(".")[2], ())
        for node in self.nodes:
            yield from (text for text in _values(node, value) if text != _text(value))


def all_keys(registry: Registry) -> Iterator[Key]:
    """Every key of every scenario, stage, machine and other part of a spec."""
    for part in parts(registry):
        for key in _keys(part.schema, Key(part.at, part.data)):
            yield replace(key, beside=(*part.beside, *key.beside, *instead(key.path)))


def _keys(schema: Mapping[str, Any], top: Key) -> Iterator[Key]:
    definitions = schema.get("$defs", {})

    def walk(node: Mapping[str, Any], here: Key, seen: tuple[str, ...]) -> Iterator[Key]:
        name = str(node.get("$ref", "")).rpartition("/")[2]
        if name and name not in seen:
            model = definitions[name]
            below = replace(here, beside=(*here.beside, *chosen_type(model, here.path)))
            yield from walk(model, below, (*seen, name))
        elif "const" not in node:  # that is a type, see below
            choices = [each for each in (*node.get("anyOf", ()), *node.get("oneOf", ())) if {*each} != {"required"}]
            models = (definitions[each["$ref"].rpartition("/")[2]] for each in choices if "$ref" in each)
            types = [text.removeprefix("=") for model in models for text in chosen_type(model, "")]
            if len(types) > 1:
                yield replace(here, nodes=({"enum": types},))
            for choice in choices:
                yield from walk(choice, here, seen)
            for key, child in node.get("properties", {}).items():
                yield from walk(child, replace(here, path=f"{here.path}.{key}".lstrip(".")), seen)
            if "$ref" in node.get("items", {}):
                yield from walk(node["items"], replace(here, path=f"{here.path}.0"), seen)
            elif not name and not choices and node.get("type") not in ("null", "object"):
                yield replace(here, nodes=(node,))

    by_place: dict[tuple[str, tuple[str, ...]], Key] = {}
    for key in walk(schema, top, ()):
        place = key.path, key.beside
        by_place[place] = replace(key, nodes=(*(by_place[place].nodes if place in by_place else ()), *key.nodes))
    yield from by_place.values()


def _values(node: Mapping[str, Any], value: Any) -> Iterator[str]:
    """Texts of values that a schema may allow, those first that are near a value."""
    yield from map(_text, node.get("enum", ()))
    type_, unit = node.get("type"), unit_of(node)
    if type_ == "boolean":
        yield from ("true", "false")
    elif type_ in ("integer", "number") or unit:
        whole = type_ == "integer"
        if isinstance(value, int | float | str) and (found := _NUMBER.match(str(value))):
            yield from (_digits(float(found[0]) * factor, whole) + unit for factor in _FACTORS if float(found[0]))
            yield from (_digits(float(found[0]) + step, whole) + unit for step in (1, -1))
        yield from (f"{number}{unit}" for number in (*(() if whole else (0.02, 0.2)), 1, 3, 6, 50, 300))
    elif type_ == "array" and isinstance(value, list):
        for factor in _FACTORS:
            yield _NUMBER.sub(lambda found, by=factor: _digits(float(found[0]) * by, False), _text(value))
        yield _text(value[:-1])
    elif type_ == "array":
        inner = node.get("items") or node.get("prefixItems", [{}])[0]
        for text in _values(inner, None):
            yield f"[{', '.join([text] * len(node.get('prefixItems', 'x')))}]"
    elif type_ == "string":
        yield from ("other", "bat", OTHER_PICTURE, *(str(sample) for sample in SAMPLES.values()))


def _digits(number: float, whole: bool) -> str:
    return str(round(number)) if whole else f"{number:.6g}"


def _text(value: Any) -> str:
    """A value as YAML writes it in a line."""
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_text(each)}' for key, each in value.items())}}}"
    return str(value) if isinstance(value, str) else json.dumps(value)
