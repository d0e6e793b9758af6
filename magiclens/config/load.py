"""From a spec file to a validated spec."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from magiclens.config.checker import Checker
from magiclens.config.document import Document, read_document
from magiclens.config.fabrication import Fabrication, find_fabrication
from magiclens.config.model import Spec


def load_spec(path: str | Path, overrides: Iterable[str] = ()) -> Spec:
    """The spec in a YAML file, ``key.path=value`` overrides laid over it; scenario and stages are not resolved.

    Raises InputError naming file, line, key, what is wrong and the nearest valid choice.
    """
    document = read_document(path, overrides)
    checker = Checker(document, {"folder": document.folder})
    return checker.settle(check_spec(document, checker, find_fabrication(document, checker)))


def check_spec(document: Document, checker: Checker, fabrication: Fabrication | None) -> Spec | None:
    """Validate everything but the scenario's and the stages' own options; named after the file by default.

    A machine says what the lens is like where the spec does not, and what it cannot be.
    """
    data = {"name": default_name(document), **document.data}
    lens = data.get("lens") or {}
    if fabrication and isinstance(lens, dict):
        data["lens"] = fabrication.lens(lens)
    spec = checker.validate(Spec, data)
    for key, objection in fabrication.objections(spec.lens) if fabrication and spec else ():
        checker.add(("lens", key), objection)
    return spec


def default_name(document: Document) -> str:
    """The file's name without its ending, what no folder should be called replaced."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._ -") else "-" for c in Path(document.name).stem)
    return kept.lstrip("._ -") or "lens"
