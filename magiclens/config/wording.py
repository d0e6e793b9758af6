"""Says in a sentence what pydantic found wrong, and what to write instead."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from magiclens.config.document import Keys
from magiclens.config.suggest import advice, shown
from magiclens.contract.units import ANGLE, FRACTION, LENGTH

NUMBER = "expected a number, got {input}"
WHOLE = "expected a whole number, got {input}"
TEXT = "expected text, got {input}"
FLAG = "expected true or false, got {input}"
LIST = "expected a list such as [a, b], got {input}"
MAPPING = "expected a mapping such as {{key: value}}, got {input}"

SENTENCES = {
    "missing": "this key is required",
    "union_tag_not_found": "the key 'type' is required; choose one of: {tags}",
    "greater_than": "must be more than {gt}, got {input}",
    "greater_than_equal": "must be at least {ge}, got {input}",
    "less_than": "must be less than {lt}, got {input}",
    "less_than_equal": "must be at most {le}, got {input}",
    "too_short": "needs at least {min_length}, has {actual_length}",
    "too_long": "takes at most {max_length}, has {actual_length}",
    "string_pattern_mismatch": "{input} is not allowed here; it must match {pattern}",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), WHOLE),
    **dict.fromkeys(("float_type", "float_parsing", "finite_number"), NUMBER),
    **dict.fromkeys(("bool_type", "bool_parsing"), FLAG),
    **dict.fromkeys(("list_type", "tuple_type"), LIST),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), MAPPING),
    "string_type": TEXT,
}


def sentence(error: ErrorDetails, written: Any, model: type[BaseModel], noun: str) -> str:
    """What is wrong with a value. ``written`` is the value as the spec has it, ``noun`` what its keys are called."""
    context = error.get("ctx", {})
    kind = error["type"]
    if kind == "extra_forbidden":
        return f"unknown {noun}; {advice(error['loc'][-1], keys_at(model, error['loc'][:-1]))}"
    if kind == "value_error":
        return str(context["error"])
    if kind in ("literal_error", "enum"):
        return f"{written!r} is not allowed; {advice(written, _quoted(context['expected']))}"
    if kind == "union_tag_invalid":
        return f"unknown type {context['tag']!r}; {advice(context['tag'], _quoted(context['expected_tags']))}"
    bounds = {name: _as_written(bound, written) for name, bound in context.items()}
    tags = ", ".join(_tags(model, error["loc"]))
    return SENTENCES.get(kind, f"{error['msg']}, got {{input}}").format(**bounds, tags=tags, input=shown(written))


def keys_at(model: type[BaseModel], at: Keys) -> list[str]:
    """The keys that a mapping may have, where ``at`` leads from a model to that mapping (pydantic's ``loc``)."""
    return [key for found in _models_at(model, at) for key in found.model_fields]


def _models_at(model: type[BaseModel], at: Keys) -> list[type[BaseModel]]:
    found = [model]
    for step in at:
        tagged = [m for m in found if step in _tag(m)]
        fields = [m.model_fields[step].annotation for m in found if isinstance(step, str) and step in m.model_fields]
        found = tagged or [m for field in fields for m in _models_in(field)] or found
    return found


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model that a type annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _tag(model: type[BaseModel]) -> tuple[Any, ...]:
    field = model.model_fields.get("type")
    return get_args(field.annotation) if field else ()


def _tags(model: type[BaseModel], at: Keys) -> list[str]:
    return sorted(str(tag) for found in _models_at(model, at) for tag in _tag(found))


def _quoted(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


def _as_written(bound: Any, written: Any) -> Any:
    """A bound in the unit in which the value was written."""
    if not isinstance(bound, int | float) or not isinstance(written, str):
        return bound
    for quantity in (FRACTION, ANGLE, LENGTH):
        if re.match(quantity.pattern, written.strip()):
            return quantity.text(bound)
    return bound
