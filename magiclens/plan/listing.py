"""What is installed, as text."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from magiclens.contract.stages import KINDS
from magiclens.plan.registry import ART, EXECUTOR, SCENARIO, STAGE, Entry, Failure, Registry


def describe_plugins(registry: Registry) -> str:
    """Kind, name, package, version and options of everything that is contributed; then what is wrong."""
    rows: list[tuple[str, ...]] = [("KIND", "NAME", "PACKAGE", "VERSION", "OPTIONS")]
    rows += [_row(key, entry) for key, entry in sorted(registry.entries.items(), key=lambda item: _rank(item[0]))]
    lines = _table(rows)
    clashes = [f"{' '.join(key)}: {_claims(entry)}" for key, entry in registry.entries.items() if entry.rivals]
    sections = {
        "names claimed twice": clashes,
        "failures": [_failure(f) for f in registry.failures],
        "remarks": [_failure(f) for f in registry.remarks],
        "disabled": [f"{plugin.name} ({plugin})" for plugin in registry.disabled],
    }
    return "\n".join([*lines, *(line for title, found in sections.items() for line in _section(title, found))])


def plugin_facts(registry: Registry) -> dict[str, Any]:
    """The same for programs: what is contributed, by whom, and what is wrong."""
    ranked = sorted(registry.entries.items(), key=lambda item: _rank(item[0]))
    return {
        "contributions": [_facts(key, entry) for key, entry in ranked],
        "failures": [_complaint(failure) for failure in registry.failures],
        "remarks": [_complaint(failure) for failure in registry.remarks],
        "disabled": [asdict(plugin) for plugin in registry.disabled],
    }


def _facts(key: tuple[str, ...], entry: Entry) -> dict[str, Any]:
    kind, name, *_ = _row(key, entry)
    claims = [asdict(plugin) for plugin in (entry.plugin, *entry.rivals)]
    options = [*map(str, getattr(entry.value, "model_fields", {}))]
    return {"kind": kind, "name": name, "plugins": claims, "options": options}


def _complaint(failure: Failure) -> dict[str, Any]:
    return {"plugin": asdict(failure.plugin), "reason": failure.reason}


def _rank(key: tuple[str, ...]) -> tuple[int, int, str]:
    """Pipeline order, then names."""
    kinds = list(KINDS)
    return (STAGE, SCENARIO, ART, EXECUTOR).index(key[0]), kinds.index(key[1]) if key[0] == STAGE else 0, key[-1]


def _row(key: tuple[str, ...], entry: Entry) -> tuple[str, ...]:
    return key[-2], key[-1], entry.plugin.package, entry.plugin.version, _options(entry.value)


def _options(value: Any) -> str:
    return ", ".join(map(str, getattr(value, "model_fields", {})))


def _claims(entry: Entry) -> str:
    return " and ".join(str(plugin) for plugin in (entry.plugin, *entry.rivals))


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _section(title: str, lines: list[str]) -> list[str]:
    return ["", f"{title}:", *lines] if lines else []


def _failure(failure: Failure) -> str:
    reason = "\n".join(f"    {line}" for line in failure.reason.splitlines())
    return f"{failure.plugin.name} ({failure.plugin}):\n{reason}"
