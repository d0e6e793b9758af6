"""Lists what is installed, for ``mlens plugins``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from magiclens.contract.stages import KINDS
from magiclens.plan.registry import ANALYSIS, EXECUTOR, NAMED_ART, SCENARIO, STAGE, Contribution, Failure, Registry


def describe_plugins(registry: Registry) -> str:
    """The table that people read: kind, name, package, version and options; below it, what is wrong with plugins."""
    rows: list[tuple[str, ...]] = [("KIND", "NAME", "PACKAGE", "VERSION", "OPTIONS")]
    rows += [_row(key, contribution) for key, contribution in _ranked(registry)]
    lines = _table(rows)
    clashes = [f"{' '.join(key)}: {_claims(one)}" for key, one in registry.contributions.items() if one.rivals]
    sections = {
        "names claimed twice": clashes,
        "failures": [_failure_text(f) for f in registry.failures],
        "remarks": [_failure_text(f) for f in registry.remarks],
        "disabled": [f"{plugin.name} ({plugin})" for plugin in registry.disabled],
    }
    return "\n".join([*lines, *(line for title, found in sections.items() for line in _section(title, found))])


def plugins_data(registry: Registry) -> dict[str, Any]:
    """What is installed as JSON data, for programs: what is contributed, by which plugin, and what is wrong."""
    return {
        "contributions": [_contribution_data(key, contribution) for key, contribution in _ranked(registry)],
        "failures": [_failure_data(failure) for failure in registry.failures],
        "remarks": [_failure_data(failure) for failure in registry.remarks],
        "disabled": [asdict(plugin) for plugin in registry.disabled],
    }


def _contribution_data(key: tuple[str, ...], contribution: Contribution) -> dict[str, Any]:
    claims = [asdict(plugin) for plugin in (contribution.plugin, *contribution.rivals)]
    return {"kind": key[-2], "name": key[-1], "plugins": claims, "options": _options(contribution)}


def _failure_data(failure: Failure) -> dict[str, Any]:
    return {"plugin": asdict(failure.plugin), "reason": failure.reason}


def _ranked(registry: Registry) -> list[tuple[tuple[str, ...], Contribution]]:
    """Contributions with their keys: stages in the order of the pipeline, then other tables; in each, by name."""
    kinds, tables = list(KINDS), (STAGE, SCENARIO, NAMED_ART, EXECUTOR, ANALYSIS)

    def rank(key: tuple[str, ...]) -> tuple[int, int, str]:
        return tables.index(key[0]), kinds.index(key[1]) if key[0] == STAGE else 0, key[-1]

    return sorted(registry.contributions.items(), key=lambda item: rank(item[0]))


def _row(key: tuple[str, ...], contribution: Contribution) -> tuple[str, ...]:
    plugin = contribution.plugin
    return key[-2], key[-1], plugin.package, plugin.version, ", ".join(_options(contribution))


def _options(contribution: Contribution) -> list[str]:
    return [*map(str, getattr(contribution.value, "model_fields", {}))]


def _claims(contribution: Contribution) -> str:
    return " and ".join(str(plugin) for plugin in (contribution.plugin, *contribution.rivals))


def _table(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _section(title: str, lines: list[str]) -> list[str]:
    return ["", f"{title}:", *lines] if lines else []


def _failure_text(failure: Failure) -> str:
    reason = "\n".join(f"    {line}" for line in failure.reason.splitlines())
    return f"{failure.plugin.name} ({failure.plugin}):\n{reason}"
