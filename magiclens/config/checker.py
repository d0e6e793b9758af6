"""Collects what is wrong with a spec and reports the first mistake as the author wrote it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from magiclens.config.document import Document, Keys, child, dotted
from magiclens.config.fields import Context
from magiclens.config.wording import sentence
from magiclens.contract.errors import InputError

T = TypeVar("T")
Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Problem:
    """One mistake, at a key that is there or ought to be."""

    at: Keys
    message: str


class Checker:
    """Validates parts of one document; nothing is raised before ``raise_first``, so that file order decides."""

    def __init__(self, document: Document, context: Context):
        self._document, self._context = document, context
        self._problems: list[Problem] = []

    def validate(self, model: type[Model], data: Any, at: Keys = (), noun: str = "key") -> Model | None:
        """The model that ``data`` (written at ``at``) describes, or None when something is wrong with it."""
        try:
            return model.model_validate(data, context=self._context)
        except ValidationError as error:
            for details in error.errors(include_url=False):
                loc, written = _as_in_yaml(details["loc"], data)
                message = sentence(details, written, model, noun)
                self._problems.append(Problem((*at, *loc), message))
            return None

    def add(self, at: Keys, message: str) -> None:
        """Note a mistake that no model can see."""
        self._problems.append(Problem(at, message))

    def raise_first(self) -> None:
        """Raise the mistake that was written first; what is missing comes after what is there."""
        if self._problems:
            first = min(self._problems, key=lambda p: (not self._document.written(p.at), self._document.order(p.at)))
            raise InputError(f"{dotted(first.at)}: {first.message}", self._document.where(first.at))

    def settle(self, result: T | None) -> T:
        """The result of a validation, once nothing was wrong."""
        self.raise_first()
        if result is None:
            raise ValueError("a validation failed without a problem")
        return result


def _as_in_yaml(loc: Keys, data: Any) -> tuple[Keys, Any]:
    """Pydantic's location without the names of union members, and the value that stands there."""
    keys: list[str | int] = []
    node, named = data, False
    for step in loc:
        named = not named and isinstance(node, dict) and node.get("type") == step
        if not named:
            keys.append(step)
            node = child(node, step)
    return tuple(keys), node
