"""What is installed, as text."""

from __future__ import annotations

from typing import Any

from magiclens.registry import ART, SCENARIO, STAGE, Entry, Registry
from magiclens.stages import KINDS


def describe_plugins(registry: Registry) -> str:
    """Kind, name, package, version and options of everything that is contributed; then what could not be loaded."""
    rows: list[tuple[str, ...]] = [("KIND", "NAME", "PACKAGE", "VERSION", "OPTIONS")]
    rows += [_row(key, entry) for key, entry in sorted(registry.entries.items(), key=lambda item: _rank(item[0]))]
    lines = _table(rows)
    clashes = [f"{' '.join(key)}: {_claims(entry)}" for key, entry in registry.entries.items() if entry.rivals]
    failures = [f"{f.plugin.name} ({f.plugin}):\n{_indented(f.reason)}" for f in registry.failures]
    return "\n".join([*lines, *_section("names claimed twice", clashes), *_section("failures", failures)])


def _rank(key: tuple[str, ...]) -> tuple[int, int, str]:
    """Pipeline order, then names."""
    kinds = list(KINDS)
    return (STAGE, SCENARIO, ART).index(key[0]), kinds.index(key[1]) if key[0] == STAGE else 0, key[-1]


def _row(key: tuple[str, ...], entry: Entry) -> tuple[str, ...]:
    return key[-2], key[-1], entry.plugin.package, entry.plugin.version, _options(entry.value)


def _options(value: Any) -> str:
    return ", ".join(getattr(value, "model_fields", {}))


def _claims(entry: Entry) -> str:
    return " and ".join(str(plugin) for plugin in (entry.plugin, *entry.rivals))


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _section(title: str, lines: list[str]) -> list[str]:
    return ["", f"{title}:", *lines] if lines else []


def _indented(text: str) -> str:
    return "\n".join(f"    {line}" for line in text.splitlines())
