"""Draws the pictures of docs/explanation/architecture.md from the code: the data flow and the layers of the package.

``python docs/draw_architecture.py`` writes ``docs/images/data-flow.svg`` and ``docs/images/layers.svg``. A test fails
while they are not what the code says.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from textwrap import wrap
from typing import Any, get_type_hints
from xml.sax.saxutils import escape

import grimp

from magiclens.analysis.base import nothing
from magiclens.builtin import mlens_analyses, mlens_stages
from magiclens.contract.result import RunResult
from magiclens.contract.stages import KINDS, Annealer, Encoder, Exporter, Finisher, Integrator, Matcher, Renderer
from magiclens.geometry.solid import solid_from_heights
from magiclens.plan.compile import Plan, load_plan
from magiclens.rendering.transports import transports
from magiclens.report.write import write_report

ROOT = Path(__file__).parent.parent
IMAGES = ROOT / "docs" / "images"
PACKAGE = "magiclens"

ARTIFACTS = ("Plan", "Scene", "Candidates", "Assignment", "HeightField", "Solid", "Transport")
"""Types that steps hand on, in the order in which they appear in a run."""


@dataclass(frozen=True)
class Step:
    """One step of a run: the function or method that does it, and in words when it happens or what it writes.

    title: what it is called, if not as its function.
    """

    work: Callable[..., Any]
    remark: str = ""
    writes: str = ""
    title: str = ""


STEPS = (
    Step(load_plan, "spec.yaml and the installed plugins"),
    Step(Plan.scene, "the scenario's shots get their pictures"),
    Step(Matcher.match),
    Step(Annealer.anneal),
    Step(Integrator.integrate),
    Step(Matcher.rematch, "while it helps, then anneal and integrate again"),
    Step(Integrator.refine, "only if the matcher uses the pictures"),
    Step(solid_from_heights, "a closed mesh"),
    Step(Finisher.finish),
    Step(transports, "only if there is an encoder"),
    Step(Encoder.encode, "new sources; codesign starts again at match, or at refine if that can go on"),
    Step(Exporter.export, writes="files"),
    Step(Renderer.render, writes="pictures"),
    Step(nothing, ", ".join(a.name for a in mlens_analyses()), "numbers", "Analysis.compute"),
    Step(write_report, writes="report"),
)
"""The steps of a run, in order. Which artifacts they read and return is read from their signatures."""

STYLE = """
  text { font: 14px system-ui, "Segoe UI", Helvetica, Arial, sans-serif; fill: #1c2128; }
  .muted { fill: #565f69; font-size: 12px; }
  .code { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: 13px; }
  .paper { fill: #ffffff; }
  .band { fill: #eef2f7; }
  .lane { stroke: #b9c0c9; fill: none; } .dotted { stroke-dasharray: 2 5; }
  .flow { stroke: #2563c9; stroke-width: 2; fill: none; }
  .read { fill: #ffffff; stroke: #2563c9; stroke-width: 2; }
  .made { fill: #b93c0a; stroke: #b93c0a; stroke-width: 2; }
  .mark { fill: #2563c9; }
  .self { fill: #b9c0c9; }
  @media (prefers-color-scheme: dark) {
    text { fill: #e6e9ed; } .muted { fill: #a2acb7; } .paper { fill: #1d2127; } .band { fill: #262c34; }
    .lane { stroke: #4a535e; } .flow { stroke: #7eb0f5; } .read { fill: #1d2127; stroke: #7eb0f5; }
    .made { fill: #fb8c4a; stroke: #fb8c4a; } .mark { fill: #7eb0f5; } .self { fill: #4a535e; }
  }
"""


def data_flow() -> str:
    """The data flow as SVG: a column per artifact, a row per step; open dots are read, full dots are made."""
    left, wide, top = 470, 112, 64
    edge = left + wide * len(ARTIFACTS)
    columns = {name: left + wide * k for k, name in enumerate(ARTIFACTS)}
    flows = [_reads_and_makes(step.work) for step in STEPS]
    words = [_who(step) for step in STEPS]
    rows = list(accumulate((34 + 15 * len(lines) for lines in words), initial=top))
    parts = []
    for name, x in columns.items():
        used = [y for y, flow in zip(rows, flows, strict=False) if name in flow[0] | flow[1]]
        parts += [_text(x, 24, name, "middle", "code"), f'<path class="dotted lane" d="M{x} 34V{used[0]}"/>']
        parts.append(f'<path class="lane" d="M{x} {used[0]}V{used[-1]}"/>')
    for y, step, lines, (reads, makes) in zip(rows, STEPS, words, flows, strict=False):
        ends = sorted(columns[name] for name in reads | makes) + ([edge] if step.writes else [])
        parts.append(_text(12, y - 6, step.title or _title(step.work), cls="code"))
        parts += [_text(12, y + 10 + 15 * k, line, cls="muted") for k, line in enumerate(lines)]
        parts.append(f'<path class="flow" d="M{ends[0]} {y}H{ends[-1]}"/>')
        parts += [_dot(columns[name], y, name in reads, name in makes) for name in ARTIFACTS if name in reads | makes]
        if step.writes:
            parts.append(f'<path class="flow" d="M{edge - 8} {y - 5}L{edge} {y}L{edge - 8} {y + 5}"/>')
            parts.append(_text(edge + 8, y + 5, step.writes))
    under = rows[-1]
    for k, (read, made, words) in enumerate(
        [(True, False, "reads it"), (False, True, "makes it"), (True, True, "reads it and makes another")]
    ):
        parts += [_dot(left + 120 * k, under, read, made), _text(left + 120 * k + 16, under + 5, words)]
    alt = "Steps of a run from top to bottom, and for each the artifacts that it reads and makes"
    return _svg(edge + 90, under + 24, alt, parts)


def layers() -> str:
    """The layers as SVG: a row and a column per folder, from the top layer down; a square where the row imports it."""
    ordered = [sorted(layer) for layer in package_layers()]
    names = [name for layer in ordered for name in layer]
    imports, cell, left, top = folder_imports(), 22, 150, 130
    size = cell * len(names)
    parts, begun = [], 0
    for k, layer in enumerate(ordered):
        at = top + cell * begun
        if k % 2 == 0:
            parts.append(f'<rect class="band" x="0" y="{at}" width="{left + size}" height="{cell * len(layer)}"/>')
        begun += len(layer)
    for k, name in enumerate(names):
        middle = top + cell * k + cell // 2
        parts.append(_text(left - 10, middle + 5, name, "end", "code"))
        x = left + cell * k + cell // 2 + 4
        parts.append(f'<text class="code" transform="translate({x} {top - 8}) rotate(-60)">{escape(name)}</text>')
        parts.append(f'<rect class="self" x="{left + cell * k + 7}" y="{top + cell * k + 7}" width="8" height="8"/>')
        for column, other in enumerate(names):
            if other in imports[name]:
                box = f'x="{left + cell * column + 4}" y="{top + cell * k + 4}" width="{cell - 8}" height="{cell - 8}"'
                parts.append(f'<rect class="mark" {box} rx="3"><title>{name} imports {other}</title></rect>')
    alt = "Which folder imports which. Folders are ordered by layer, and every mark lies right of the diagonal"
    return _svg(left + size + 70, top + size + 12, alt, parts)


def package_layers() -> list[list[str]]:
    """The layers of the package from top to bottom, as pyproject.toml has them for import-linter."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (contract,) = (c for c in project["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    return [[name.strip(" ()") for name in re.split(r"[|:]", layer)] for layer in contract["layers"]]


def folder_imports() -> dict[str, set[str]]:
    """For every module or folder directly in the package: which others it imports, inside functions too."""
    graph = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True, cache_dir=None)
    found: dict[str, set[str]] = {name: set() for layer in package_layers() for name in layer}
    for module in graph.modules:
        for imported in graph.find_modules_directly_imported_by(module):
            importer, other = _folder(module), _folder(imported)
            if importer != other and importer in found and other in found:
                found[importer].add(other)
    return found


def _folder(module: str) -> str:
    """The folder that a module is in: ``cli`` of ``magiclens.cli.run``."""
    return module.split(".")[1] if "." in module else ""


def _reads_and_makes(work: Callable[..., Any]) -> tuple[set[str], set[str]]:
    """The artifacts that a function's parameters and its result are made of."""
    hints = get_type_hints(work)
    makes = _named([hints.pop("return", None)])
    whole = list(get_type_hints(RunResult).values()) if RunResult in hints.values() else []
    owner = work.__qualname__.partition(".")[0]
    return _named([owner, *whole, *hints.values()]), makes


def _named(types: Iterable[object]) -> set[str]:
    """The artifacts that types name, ``Sequence[Transport]`` too."""
    return {name for name in ARTIFACTS if any(re.search(rf"\b{name}\b", str(each)) for each in types)}


def _title(work: Callable[..., Any]) -> str:
    """What a step is called in the code."""
    return work.__qualname__ if "." in work.__qualname__ else f"{work.__name__}()"


def _who(step: Step) -> list[str]:
    """The folders that do a step, with the built-in stages to choose from or the remark, in short lines."""
    kinds = [kind for kind, cls in KINDS.items() if cls.__name__ == step.work.__qualname__.partition(".")[0]]
    stages = [cls for cls in mlens_stages() if cls.kind in kinds]
    folders = dict.fromkeys(_folder(cls.__module__) for cls in stages) or [_folder(step.work.__module__)]
    if step.remark:
        return wrap(f"{', '.join(f'{folder}/' for folder in folders)} {step.remark}", 76)
    lines = []
    for folder in folders:
        names = ", ".join(cls.type for cls in stages if _folder(cls.__module__) == folder)
        lines += wrap(f"{folder}/ {names}", 76)
    return lines


def _dot(x: float, y: float, read: bool, made: bool) -> str:
    """An artifact that a step reads, makes, or makes from another of its kind."""
    inner = f'<circle class="made" cx="{x}" cy="{y}" r="{4 if read else 7}"/>' if made else ""
    return (f'<circle class="read" cx="{x}" cy="{y}" r="{9 if made else 6}"/>' if read else "") + inner


def _text(x: float, y: float, words: str, anchor: str = "start", cls: str = "") -> str:
    attributes = f' class="{cls}"' if cls else ""
    return f'<text{attributes} x="{x}" y="{y}" text-anchor="{anchor}">{escape(words)}</text>'


def _svg(width: int, height: int, alt: str, parts: Sequence[str]) -> str:
    box = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {box} role="img" aria-label="{escape(alt)}">'
    sheet = f'<rect class="paper" width="{width}" height="{height}"/>'
    return "\n".join([head, f"<style>{STYLE}</style>", sheet, *parts, "</svg>", ""])


def drawings() -> Iterator[tuple[Path, str]]:
    """Every drawing and where it belongs."""
    yield IMAGES / "data-flow.svg", data_flow()
    yield IMAGES / "layers.svg", layers()


if __name__ == "__main__":
    for path, drawn in drawings():
        path.write_text(drawn, encoding="utf-8")
