"""Loads a spec file into a validated spec."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from magiclens.config.checker import Checker
from magiclens.config.document import Document, read_document
from magiclens.config.fabrication import Fabrication, find_fabrication
from magiclens.config.model import AUTO, Spec


def load_spec(path: str | Path, overrides: Iterable[str] = ()) -> Spec:
    """Load a spec. Its scenario and stages stay mappings: ``load_plan`` resolves those.

    Args:
        path: The spec, a YAML file.
        overrides: Values to change, as text ``key.path=value``, such as ``lens.facets=64``.

    Returns:
        The spec, with the defaults of the machine that it names.

    Raises:
        InputError: The spec has a mistake. The message names file, line and key, and proposes what to write.
    """
    document = read_document(path, overrides)
    checker = Checker(document, {"folder": document.folder})
    return checker.settle(check_spec(document, checker, find_fabrication(document, checker), {}))


def check_spec(
    document: Document, checker: Checker, fabrication: Fabrication | None, usual: Mapping[str, Any]
) -> Spec | None:
    """Validate everything but the options of scenario and stages.

    Args:
        document: The spec as it was read; its file's name is the default of the spec's name.
        checker: Notes the mistakes.
        fabrication: The machine that the spec names. It has defaults of its own for the lens, and limits.
        usual: Keys of the lens that suit the scenario, if the spec writes none of them and names no machine.

    Returns:
        The spec; None if it has mistakes.
    """
    data = {"name": default_name(document), **document.data}
    lens = data.get("lens") or {}
    if fabrication and isinstance(lens, dict):
        data["lens"] = fabrication.lens(lens)
    elif isinstance(lens, dict):
        if document.data.get("fabrication"):  # its mistake is noted, and leaves open how many facets suit the machine
            lens = {key: value for key, value in lens.items() if value != AUTO}
        data["lens"] = {**usual, **lens} if not lens.keys() & usual.keys() else lens
    spec = checker.validate(Spec, data)
    for key, objection in fabrication.objections(spec.lens) if fabrication and spec else ():
        checker.add(("lens", key), objection)
    return spec


def default_name(document: Document) -> str:
    """The name of a spec that has none: its file's, without the ending and without letters that folders cannot have."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._ -") else "-" for c in Path(document.name).stem)
    return kept.lstrip("._ -") or "lens"
