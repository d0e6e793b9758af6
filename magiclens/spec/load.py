"""From a spec file to a validated spec."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from magiclens.spec.checker import Checker
from magiclens.spec.document import Document, read_document
from magiclens.spec.model import Spec


def load_spec(path: str | Path, overrides: Iterable[str] = ()) -> Spec:
    """The spec in a YAML file, ``key.path=value`` overrides laid over it; scenario and stages are not resolved.

    Raises InputError naming file, line, key, what is wrong and the nearest valid choice.
    """
    document = read_document(path, overrides)
    checker = Checker(document, {"folder": document.folder})
    return checker.settle(check_spec(document, checker))


def check_spec(document: Document, checker: Checker) -> Spec | None:
    """Validate everything but the scenario's and the stages' own options; named after the file by default."""
    return checker.validate(Spec, {"name": default_name(document), **document.data})


def default_name(document: Document) -> str:
    """The file's name without its ending, what no folder should be called replaced."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._ -") else "-" for c in Path(document.name).stem)
    return kept.lstrip("._ -") or "lens"
