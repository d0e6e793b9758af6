"""The data files of machines and materials."""

from __future__ import annotations

from importlib.resources import files
from typing import Any


def read_data(name: str) -> dict[str, Any]:
    """Read the mapping in a YAML file of this folder."""
    from ruamel.yaml import YAML

    found: dict[str, Any] = YAML(typ="safe").load((files("magiclens.profiles") / name).read_text(encoding="utf-8"))
    return found
