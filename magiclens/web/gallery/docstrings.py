"""Reads Google-style docstrings, so that the reference can show their sections as tables."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence
from typing import Any

from magiclens.web.gallery.parts import Block, Table, Text

_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises):\n", re.MULTILINE)
_ENTRY = re.compile(r"^(\w[\w, ]*): ", re.MULTILINE)
_HEADS = {"Args": ("Argument", "What it is"), "Attributes": ("Attribute", "What it is"), "Raises": ("Error", "When")}


def prose(thing: Any) -> str:
    """The docstring of a class or a function up to its first section."""
    return _SECTION.split(inspect.getdoc(thing) or "")[0].strip()


def sections(thing: Any) -> list[Block]:
    """The sections of a docstring: a table of each that lists names, and a paragraph of what is returned."""
    parts = _SECTION.split(inspect.getdoc(thing) or "")[1:]
    return [_block(title, inspect.cleandoc(text)) for title, text in zip(parts[::2], parts[1::2], strict=True)]


def _block(title: str, text: str) -> Block:
    if title == "Returns":
        return Text(f"**{title}** {text}")
    return Table("", _HEADS[title], _entries(text))


def _entries(text: str) -> Sequence[tuple[str, ...]]:
    """Names and their texts, which may take several indented lines."""
    parts = _ENTRY.split(text)[1:]
    return [(f"`{name}`", " ".join(entry.split())) for name, entry in zip(parts[::2], parts[1::2], strict=True)]
