"""The keys of a model as tables: name, what it takes, what it is unless written, what it means."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from magiclens.config.fields import ART_FORMAT
from magiclens.config.schema import Draft7
from magiclens.contract.units import ANGLE, FRACTION, LENGTH, Quantity
from magiclens.web.gallery.parts import Table

HEAD = ("Key", "Takes", "Default", "Meaning")
LIMITS = {
    "minimum": "≥", "exclusiveMinimum": ">", "ge": "≥", "gt": ">",
    "maximum": "≤", "exclusiveMaximum": "<", "le": "≤", "lt": "<",
}  # fmt: skip
Schema = Mapping[str, Any]


def model_tables(model: type[BaseModel]) -> list[Table]:
    """One table of the model's own keys, and one for each kind of mapping that they take. None if there are no keys."""
    schema = model.model_json_schema(schema_generator=Draft7)
    shapes = schema.get("$defs", {})
    own = [_table("", schema)] if schema.get("properties") else []
    return own + [_table(_title(shape), shape) for shape in shapes.values() if shape.get("properties")]


def takes(schema: Schema) -> str:
    """What a key takes, in words: ``length``, ``a | b``, ``list of share``."""
    return " or ".join(dict.fromkeys(_kinds(schema)))


def _kinds(schema: Schema) -> Iterator[str]:
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


def _list(schema: Schema) -> str:
    items = schema.get("prefixItems") or [schema.get("items", {})]
    return f"list of {' and '.join(dict.fromkeys(takes(item) for item in items))}"


def _pattern(pattern: str) -> str:
    """Which of the quantities with units it is."""
    nouns: dict[str, Quantity] = {"length": LENGTH, "angle": ANGLE, "share": FRACTION}
    found = [noun for noun, quantity in nouns.items() if quantity.pattern in pattern]
    return " or ".join(found) or ("speed" if "mm/min" in pattern else "text")


def _plain(schema: Schema) -> str:
    words = {"integer": "whole number", "boolean": "true or false", "string": "text", "object": "mapping"}
    type_ = str(schema.get("type", "anything"))
    return words.get(type_, type_)


def _limits(schema: Schema) -> str:
    found = [f"{sign} {schema[key]:g}" for key, sign in LIMITS.items() if isinstance(schema.get(key), int | float)]
    return f", {', '.join(found)}" if found else ""


def _table(note: str, schema: Schema) -> Table:
    required = schema.get("required", ())
    rows = [
        (f"`{key}`", takes(value), _default(value, key in required), str(value.get("description", "")))
        for key, value in schema["properties"].items()
    ]
    return Table(note, HEAD, rows)


def _default(schema: Schema, required: bool) -> str:
    if required:
        return "required"
    value = schema.get("default")
    if value is None:
        return ""
    return f"`{value if isinstance(value, str) else json.dumps(value)}`"


def _title(schema: Schema) -> str:
    """What a kind of mapping is called, and is."""
    about = str(schema.get("description", "")).split("\n\n")[0].replace("\n", " ")
    return f"**{{{schema['title']}}}** {about}"
