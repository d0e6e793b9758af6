"""The JSON Schema of specs, for editors. It is draft 7, which all editors read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.errors import PydanticInvalidForJsonSchema
from pydantic.json_schema import GenerateJsonSchema

from magiclens.config.fields import ART_FORMAT
from magiclens.config.model import DEFAULT_STAGES, LISTED_STAGES, Spec
from magiclens.contract.units import LengthOrPercent
from magiclens.profiles.machines import PROCESSES, machines

_Classes = Mapping[str, type[BaseModel]]
"""Models by the ``type`` that a spec picks them by."""

_DRAFT = "http://json-schema.org/draft-07/schema#"
_REF = "#/definitions/"
_ART_DEFINITION = "ArtName"
_SINGLE_STAGES = (*DEFAULT_STAGES, "encoder")
"""Kinds of which a pipeline has one stage; its mapping may have options without a ``type``."""


class Draft7(GenerateJsonSchema):
    """Pydantic's generator of JSON Schemas, with defaults as a spec writes them."""

    def encode_default(self, dft: Any) -> Any:
        """The default of a field, as text if a spec writes it as text."""
        return str(dft) if isinstance(dft, LengthOrPercent) else super().encode_default(dft)


def json_schema(scenarios: _Classes, stages: Mapping[str, _Classes], art: Iterable[str]) -> dict[str, Any]:
    """The schema of a whole spec.

    Args:
        scenarios: Scenarios by type.
        stages: By kind, the stages of that kind by type.
        art: Names of all pictures.

    Returns:
        The schema as JSON data. Every class has a definition of its own, ``<kind>-<type>``.
    """
    spec = Spec.model_json_schema(ref_template=f"{_REF}{{model}}", schema_generator=Draft7)
    definitions = spec.pop("$defs")
    for noun, classes in {"scenario": scenarios, **stages}.items():
        for type_, cls in classes.items():
            definitions[f"{noun}-{type_}"] = _definition(noun, type_, cls)
    for process, model in PROCESSES.items():
        definitions[f"machine-{process}"] = _machine(process, model)
    _set(spec["properties"]["scenario"], _one_of("scenario", scenarios))
    _set(spec["properties"]["fabrication"], {**_one_of("machine", PROCESSES), "type": "object"})
    pipeline = definitions["PipelineSpec"]["properties"]
    for kind in _SINGLE_STAGES:
        _set(pipeline[kind], _any_of(kind, stages[kind]))
    for key, kind in LISTED_STAGES.items():
        pipeline[key]["items"] = _one_of(kind, stages[kind])
    whole = {"$schema": _DRAFT, **spec, "title": "magic lens spec"}
    return {**_as_draft_7(whole), "definitions": {**_as_draft_7(definitions), _ART_DEFINITION: {"enum": sorted(art)}}}


def _definition(noun: str, type_: str, cls: type[BaseModel]) -> dict[str, Any]:
    """The options of one class and the ``type`` that picks it, its own definitions inside."""
    try:
        schema = _self_contained(f"{noun}-{type_}", cls)
    except PydanticInvalidForJsonSchema:  # an option of a plugin has a type that JSON does not have
        schema = {"type": "object", "definitions": {}}
    return {
        **schema,
        "properties": {"type": {"const": type_}, **schema.get("properties", {})},
        "required": [*([] if noun in _SINGLE_STAGES else ["type"]), *schema.get("required", [])],
    }


def _self_contained(name: str, model: type[BaseModel]) -> dict[str, Any]:
    """The schema of a model that will be the definition of this name, its own definitions inside."""
    # inside, since classes of different plugins may use models of the same name
    schema = model.model_json_schema(ref_template=f"{_REF}{name}/definitions/{{model}}", schema_generator=Draft7)
    return {**schema, "definitions": schema.get("$defs", {})}


def _machine(process: str, model: type[BaseModel]) -> dict[str, Any]:
    """The options of the machines of one process, and their names."""
    schema = _self_contained(f"machine-{process}", model)
    names = [name for name, profile in machines().items() if profile.process == process]
    properties = {"machine": {"enum": names}, **schema["properties"]}
    return {**schema, "properties": properties, "required": ["machine"]}


def _one_of(noun: str, classes: _Classes) -> dict[str, Any]:
    choices = [{"$ref": f"{_REF}{noun}-{type_}"} for type_ in sorted(classes)]
    # an empty oneOf is not allowed in JSON Schema
    return {"oneOf": choices} if choices else {"type": "object"}


def _any_of(kind: str, classes: _Classes) -> dict[str, Any]:
    # options without a type may fit several stages, which oneOf would refuse
    return {"anyOf" if key == "oneOf" else key: value for key, value in _one_of(kind, classes).items()}


def _set(schema: dict[str, Any], choice: dict[str, Any]) -> None:
    """Replace what a value may be, in place; its title and description stay."""
    kept = {key: schema[key] for key in ("title", "description") if key in schema}
    schema.clear()
    schema.update(kept | choice)


def _as_draft_7(node: Any) -> Any:
    """A schema of draft 2020-12 in the words of draft 7, without the keywords of OpenAPI."""
    if isinstance(node, list):
        return [_as_draft_7(item) for item in node]
    if not isinstance(node, dict):
        return node
    if node.get("format") == ART_FORMAT:
        return {"$ref": f"{_REF}{_ART_DEFINITION}"}
    # OpenAPI's 'discriminator' stands beside 'oneOf'; anywhere else it may be the name of an option
    gone = {"$defs"} | ({"discriminator"} if "oneOf" in node else set())
    # the items of a tuple: draft 7 lists them under 'items'
    renamed = {"prefixItems": "items"} if node.get("type") == "array" else {}
    return {renamed.get(key, key): _as_draft_7(value) for key, value in node.items() if key not in gone}
