"""Refuses YAML that would take too much time or memory, or fail without a line, before it is read.

A few aliases of aliases stand for millions of values. The events of the parser show that before any value is made.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from datetime import datetime
from typing import Any

from magiclens.contract.errors import InputError

MOST_SPEC_BYTES = 500_000
"""The longest text that is read; the parser takes some seconds for so much."""
MOST_LINES = 50_000
"""The most lines, since the parser looks at each of those that are empty, too."""
MOST_VALUES = 20_000
"""The most values, those counted several times that aliases repeat; the parser makes about as many in a second."""
MOST_LEVELS = 50
"""The deepest nesting; the parser calls itself for every level."""
MOST_DIGITS = 400
"""The longest number; more digits than any float has."""
_DATE = re.compile(r"(\d{4})-(\d\d?)-(\d\d?)(?:[Tt ]+(\d\d?):(\d\d):(\d\d)\S*)?$")
_NUMBER = re.compile(r"[-+]?[0-9][0-9_a-fA-Fxo.:+-]*$")


def check_yaml(text: str, name: str) -> None:
    """Check a text before it is read.

    Args:
        text: YAML.
        name: Names the text in errors: its file or its option.

    Raises:
        InputError: It is too long, holds too many values or levels, or something that no spec needs and that the parser
            would fail on: tags, keys that are no words, aliases of what they are in, numbers that are too long, dates
            that do not exist. The error names the line.
        ruamel.yaml.error.YAMLError: It is not YAML.
    """
    if len(text) > MOST_SPEC_BYTES:
        raise InputError(f"this is longer than {MOST_SPEC_BYTES // 1000} kB; a spec is a short text", f"{name}:1")
    if text.count("\n") > MOST_LINES:
        raise InputError(f"here are more than {MOST_LINES} lines; a spec is a short text", f"{name}:{MOST_LINES + 1}")
    sizes: dict[str, int | None] = {}
    opened: list[tuple[str | None, int]] = []
    values = 0
    for event in _with_plain_keys(_events(text), name):
        kind, where = type(event).__name__, f"{name}:{event.start_mark.line + 1}"
        if kind in ("MappingEndEvent", "SequenceEndEvent"):
            anchor, before = opened.pop()
            if anchor:
                sizes[anchor] = values - before
        elif kind == "AliasEvent":
            values += _size_of(event.anchor, sizes, where)
        elif kind in ("MappingStartEvent", "SequenceStartEvent", "ScalarEvent"):
            _check_tag(event, where)
            if event.anchor in sizes:
                raise InputError(f"'&{event.anchor}' is the name of something above already", where)
            values += 1
            if kind == "ScalarEvent":
                _check_scalar(event, where)
                if event.anchor:
                    sizes[event.anchor] = 1
            else:
                opened.append((event.anchor, values - 1))
                if event.anchor:
                    sizes[event.anchor] = None
        if values > MOST_VALUES:
            raise InputError(f"here are more than {MOST_VALUES} values, those of aliases included", where)
        if len(opened) > MOST_LEVELS:
            raise InputError("this is nested too deeply", where)


def _events(text: str) -> Iterator[Any]:
    from ruamel.yaml import YAML

    return iter(YAML(typ="rt").parse(text))


def _with_plain_keys(events: Iterable[Any], name: str) -> Iterator[Any]:
    """The same events. Raises InputError at a key that is a mapping, a list or an alias, on which the parser fails."""
    at_key: list[bool | None] = []  # for each mapping that is open: whether a key comes next; None for lists
    for event in events:
        kind = type(event).__name__
        if kind in ("MappingEndEvent", "SequenceEndEvent"):
            at_key.pop()
        elif kind in ("MappingStartEvent", "SequenceStartEvent", "ScalarEvent", "AliasEvent"):
            if at_key and at_key[-1] is not None:
                if at_key[-1] and kind != "ScalarEvent":
                    where = f"{name}:{event.start_mark.line + 1}"
                    raise InputError("a key is a word, not a mapping, a list or an alias", where)
                at_key[-1] = not at_key[-1]
            if kind in ("MappingStartEvent", "SequenceStartEvent"):
                at_key.append(True if kind == "MappingStartEvent" else None)
        yield event


def _size_of(anchor: str, sizes: dict[str, int | None], where: str) -> int:
    """How many values an alias stands for; 0 if its anchor is unknown, which the parser reports."""
    size = sizes.get(anchor, 0)
    if size is None:
        raise InputError(f"'*{anchor}' is inside what it stands for", where)
    return size


def _check_tag(event: Any, where: str) -> None:
    tag = event.tag if isinstance(event.tag, str | None) else str(event.ctag)
    if tag and tag != "!":
        raise InputError(f"the tag '{tag}' is not known here; leave it out", where)


def _check_scalar(event: Any, where: str) -> None:
    """Raise InputError for a number or a date, as YAML takes text without quotes, that Python cannot hold."""
    if event.style is not None:  # in quotes, or a block of text
        return
    if len(event.value) > MOST_DIGITS and _NUMBER.match(event.value):
        raise InputError(f"this number has {len(event.value)} digits", where)
    found = _DATE.match(event.value)
    if found:
        try:
            year, month, day, hour, minute, second = (int(part or 0) for part in found.groups())
            datetime(year, month, day, hour, minute, second)
        except ValueError:
            raise InputError(f"there is no date '{event.value}'; put text in quotes", where) from None
