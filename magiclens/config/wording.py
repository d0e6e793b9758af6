"""Turns errors of pydantic into sentences that say what is wrong and what to write instead."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from magiclens.config.document import Keys
from magiclens.config.suggest import advice, quoted
from magiclens.contract.units import ANGLE, FRACTION, LENGTH

_NUMBER = "expected a number, got {input}"
_WHOLE = "expected a whole number, got {input}"
_TEXT = "expected text, got {input}"
_FLAG = "expected true or false, got {input}"
_LIST = "expected a list such as [a, b], got {input}"
_MAPPING = "expected a mapping such as {{key: value}}, got {input}"

_SENTENCES = {
    "missing": "this key is required",
    "union_tag_not_found": "the key 'type' is required; choose one of: {tags}",
    "greater_than": "must be more than {gt}, got {input}",
    "greater_than_equal": "must be at least {ge}, got {input}",
    "less_than": "must be less than {lt}, got {input}",
    "less_than_equal": "must be at most {le}, got {input}",
    "too_short": "needs at least {min_length}, has {actual_length}",
    "too_long": "takes at most {max_length}, has {actual_length}",
    "string_pattern_mismatch": "{input} is not allowed here; it must match {pattern}",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), _WHOLE),
    **dict.fromkeys(("float_type", "float_parsing", "finite_number"), _NUMBER),
    **dict.fromkeys(("bool_type", "bool_parsing"), _FLAG),
    **dict.fromkeys(("list_type", "tuple_type"), _LIST),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), _MAPPING),
    "string_type": _TEXT,
}
"""Sentences by pydantic's error type, with placeholders for its context, the quoted input and the allowed tags."""


def sentence(error: ErrorDetails, written: Any, model: type[BaseModel], noun: str) -> str:
    """What is wrong with a value, in a sentence.

    Args:
        error: One of the errors that pydantic found.
        written: The value as the spec has it.
        model: The model that the spec was validated with.
        noun: What a key of this model is called, such as ``option``.
    """
    context = error.get("ctx", {})
    kind = error["type"]
    if kind == "extra_forbidden":
        return f"unknown {noun}; {advice(error['loc'][-1], keys_at(model, error['loc'][:-1]))}"
    if kind == "value_error":
        return str(context["error"])
    if kind in ("literal_error", "enum"):
        return f"{written!r} is not allowed; {advice(written, _words_in_quotes(context['expected']))}"
    if kind == "union_tag_invalid":
        return f"unknown type {context['tag']!r}; {advice(context['tag'], _words_in_quotes(context['expected_tags']))}"
    bounds = {name: _as_written(bound, written) for name, bound in context.items()}
    tags = ", ".join(_tags(model, error["loc"]))
    return _SENTENCES.get(kind, f"{error['msg']}, got {{input}}").format(**bounds, tags=tags, input=quoted(written))


def keys_at(model: type[BaseModel], at: Keys) -> list[str]:
    """The keys that a mapping may have.

    Args:
        model: The model of the outermost mapping.
        at: Where the mapping is in it, as in pydantic's ``loc``.
    """
    return [key for found in _models_at(model, at) for key in found.model_fields]


def _models_at(model: type[BaseModel], at: Keys) -> list[type[BaseModel]]:
    # several models, since a field may be a union
    found = [model]
    for step in at:
        tagged = [m for m in found if step in _tag(m)]
        fields = [m.model_fields[step].annotation for m in found if isinstance(step, str) and step in m.model_fields]
        # an index of a list is neither a tag nor a field: the models of its items are those found already
        found = tagged or [m for field in fields for m in _models_in(field)] or found
    return found


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model that a type annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _tag(model: type[BaseModel]) -> tuple[Any, ...]:
    """The values of a model's ``type`` by which a union picks it; none if it has no such field."""
    field = model.model_fields.get("type")
    return get_args(field.annotation) if field else ()


def _tags(model: type[BaseModel], at: Keys) -> list[str]:
    return sorted(str(tag) for found in _models_at(model, at) for tag in _tag(found))


def _words_in_quotes(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


def _as_written(bound: Any, written: Any) -> Any:
    """A bound with a unit, if the value was written with one: 90deg where it was 100deg, 90 where it was 100."""
    if not isinstance(bound, int | float) or not isinstance(written, str):
        return bound
    # pydantic knows the bounds as plain numbers only
    for quantity in (FRACTION, ANGLE, LENGTH):
        if re.match(quantity.pattern, written.strip()):
            return quantity.text(bound)
    return bound
