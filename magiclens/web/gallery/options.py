"""The keys of a pydantic model as tables: name, kind of value, default, meaning."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from magiclens.config.fields import ART_FORMAT
from magiclens.config.schema import Draft7
from magiclens.contract.units import ANGLE, FRACTION, LENGTH, Quantity
from magiclens.web.gallery.parts import Table

_HEAD = ("Key", "Takes", "Default", "Meaning")
_LIMITS = {
    "minimum": "≥", "exclusiveMinimum": ">", "ge": "≥", "gt": ">",
    "maximum": "≤", "exclusiveMaximum": "<", "le": "≤", "lt": "<",
}  # fmt: skip
"""Signs of limits, by their names in JSON Schema and in pydantic."""
_Schema = Mapping[str, Any]


def model_tables(model: type[BaseModel]) -> list[Table]:
    """A table of the model's own keys, then one for each kind of mapping that they take; no table if it has no keys."""
    schema = model.model_json_schema(schema_generator=Draft7)
    shapes = schema.get("$defs", {})
    own = [_table("", schema)] if schema.get("properties") else []
    return own + [_table(_title(shape), shape) for shape in shapes.values() if shape.get("properties")]


def value_kind(schema: _Schema) -> str:
    """The kind of value that a key takes, in words: ``length``, ``a or b``, ``list of share``."""
    return " or ".join(dict.fromkeys(_kinds(schema)))


def _kinds(schema: _Schema) -> Iterator[str]:
    for key in ("anyOf", "oneOf"):
        if key in schema and "properties" not in schema:
            for choice in schema[key]:
                yield from _kinds(choice) if choice.get("type") != "null" else ()
            return
    if "$ref" in schema:
        yield f"{{{schema['$ref'].rsplit('/', 1)[-1]}}}"
    elif "enum" in schema:
        yield " or ".join(f"`{value}`" for value in schema["enum"] if value is not None)
    elif "const" in schema:
        yield f"`{schema['const']}`"
    elif schema.get("type") == "array":
        yield _list(schema)
    elif schema.get("format") == ART_FORMAT:
        yield "name of art"
    elif "pattern" in schema:
        yield _pattern(str(schema["pattern"])) + _limits(schema)
    else:
        yield _plain(schema) + _limits(schema)


def _list(schema: _Schema) -> str:
    items = schema.get("prefixItems") or [schema.get("items", {})]
    return f"list of {' and '.join(dict.fromkeys(value_kind(item) for item in items))}"


def _pattern(pattern: str) -> str:
    """The quantity whose numbers a pattern allows."""
    nouns: dict[str, Quantity] = {"length": LENGTH, "angle": ANGLE, "share": FRACTION}
    found = [noun for noun, quantity in nouns.items() if quantity.pattern in pattern]
    return " or ".join(found) or ("speed" if "mm/min" in pattern else "text")


def _plain(schema: _Schema) -> str:
    words = {"integer": "whole number", "boolean": "true or false", "string": "text", "object": "mapping"}
    type_ = str(schema.get("type", "anything"))
    return words.get(type_, type_)


def _limits(schema: _Schema) -> str:
    found = [f"{sign} {schema[key]:g}" for key, sign in _LIMITS.items() if isinstance(schema.get(key), int | float)]
    return f", {', '.join(found)}" if found else ""


def _table(note: str, schema: _Schema) -> Table:
    required = schema.get("required", ())
    rows = [
        (f"`{key}`", value_kind(value), _default(value, key in required), str(value.get("description", "")))
        for key, value in schema["properties"].items()
    ]
    return Table(note, _HEAD, rows)


def _default(schema: _Schema, required: bool) -> str:
    if required:
        return "required"
    value = schema.get("default")
    if value is None:
        return ""
    return f"`{value if isinstance(value, str) else json.dumps(value)}`"


def _title(schema: _Schema) -> str:
    """Name and description of a kind of mapping."""
    about = str(schema.get("description", "")).split("\n\n")[0].replace("\n", " ")
    return f"**{{{schema['title']}}}** {about}"
