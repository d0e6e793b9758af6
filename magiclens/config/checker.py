"""Validates the parts of a spec and reports the mistake that comes first in the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from magiclens.config.document import Document, Keys, child, dotted
from magiclens.config.fields import Context
from magiclens.config.wording import sentence
from magiclens.contract.errors import InputError

_T = TypeVar("_T")
_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True)
class _Problem:
    """One mistake, at a key that is in the spec or is missing from it."""

    at: Keys
    message: str


class Checker:
    """Validates parts of one document and collects the mistakes.

    Nothing is raised before ``raise_first`` or ``settle``, so that the first mistake in the file is reported, whatever
    was validated first.
    """

    def __init__(self, document: Document, context: Context):
        self._document, self._context = document, context
        self._problems: list[_Problem] = []

    def validate(self, model: type[_Model], data: Any, at: Keys = (), noun: str = "key") -> _Model | None:
        """Validate one part of the document.

        Args:
            model: The model of this part.
            data: The part, as plain data.
            at: Where the part is in the document.
            noun: What a key of this part is called in messages, such as ``option``.

        Returns:
            The validated model; None if the part has mistakes, which are then noted.
        """
        try:
            return model.model_validate(data, context=self._context)
        except ValidationError as error:
            for details in error.errors(include_url=False):
                loc, written = _as_in_yaml(details["loc"], data)
                message = sentence(details, written, model, noun)
                self._problems.append(_Problem((*at, *loc), message))
            return None

    def add(self, at: Keys, message: str) -> None:
        """Note a mistake that no model can find, such as two stages that write the same file."""
        self._problems.append(_Problem(at, message))

    def raise_first(self) -> None:
        """Raise an InputError about the mistake that comes first in the file; missing keys come after all others."""
        if self._problems:
            # what is missing may follow from a misspelt key, which is the mistake to show then
            key = lambda p: (not self._document.written(p.at), self._document.order(p.at))  # noqa: E731
            first, *others = sorted(self._problems, key=key)
            raise InputError(*self._told(first), others=tuple(InputError(*self._told(other)) for other in others))

    def _told(self, problem: _Problem) -> tuple[str, str]:
        return f"{dotted(problem.at)}: {problem.message}", self._document.where(problem.at)

    def settle(self, result: _T | None) -> _T:
        """The result of a validation; raises an InputError instead if there was any mistake in the document."""
        self.raise_first()
        if result is None:
            raise ValueError("a validation failed without a problem")
        return result


def _as_in_yaml(loc: Keys, data: Any) -> tuple[Keys, Any]:
    """Pydantic's location of an error without the types of union members, and the value at that location.

    Args:
        loc: Pydantic's location: keys, list indices, and types of union members.
        data: What was validated, as plain data.
    """
    keys: list[str | int] = []
    node, named = data, False
    for step in loc:
        # pydantic inserts the type of a union's member, which is not a key of the file; it does so once, so an option
        # that has the same name as the type, and follows it, is a key again
        named = not named and isinstance(node, dict) and node.get("type") == step
        if not named:
            keys.append(step)
            node = child(node, step)
    return tuple(keys), node
