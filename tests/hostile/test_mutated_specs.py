"""Specs that were changed at random pass the check, or are refused in one line that names the line of the file."""

from __future__ import annotations

import copy
import io
import random
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from typer.testing import CliRunner

from magiclens.cli import app
from magiclens.plan.registry import Registry

SPECS = Path(__file__).parents[2] / "specs"
TEXTS = [path.read_text(encoding="utf-8") for path in sorted(SPECS.glob("*.yaml"))]
ODD: list[Any] = [
    None, True, False, 0, -1, 1, 3, 1e308, -1e-308, float("nan"), float("inf"), 10**30, "", " ", "0", "1e9", "-1mm",
    "3 mm", "1e400mm", "nanmm", "infdeg", "100%", "-5%", "mm", "yes", "~", "../../etc/passwd", "/dev/zero", "/", ".",
    "x" * 5000, "ключ", "鍵", "\u202eabc", "e\u0301", "\U0001f600", "a\nb", "\x7f", "\u2028", "{x}", "%s", "*", "&a",
    "!!", [], {}, [[]], [None], {"type": None}, {"type": "image"}, {"type": []}, {"art": "heart"}, {"art": ["heart"]},
    {"": ""}, {1: 2}, {None: 1}, {True: False}, [1, 2, 3], ["a"] * 40,
]  # fmt: skip
"""Values for every place."""
Node = dict[Any, Any] | list[Any]


def places(node: Any) -> Iterator[tuple[Node, Any]]:
    """Every value of a tree: what holds it, and its key there."""
    for key in list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
        yield node, key
        yield from places(node[key])


def dropped(node: Node, key: Any, _: random.Random) -> None:
    del node[key]


def doubled(node: Node, key: Any, rng: random.Random) -> None:
    if isinstance(node, list):
        node.insert(key, copy.deepcopy(node[key]))
    else:
        node[rng.choice([f"{key}s", f"{key}"[:-1], f" {key}", str(key).upper(), f"{key}\u0301"])] = node[key]


def retyped(node: Node, key: Any, rng: random.Random) -> None:
    node[key] = copy.deepcopy(rng.choice(ODD))


def renumbered(node: Node, key: Any, rng: random.Random) -> None:
    factor = rng.choice([0, -1, 1e-9, 1e-3, 0.1, 0.5, 2, 10, 1e3, 1e9])
    value = node[key]
    if isinstance(value, int | float) and not isinstance(value, bool):
        node[key] = type(value)(value * factor)
    elif isinstance(value, str):
        node[key] = re.sub(r"\d+(\.\d+)?", lambda found: f"{float(found[0]) * factor:g}", value)


def wrapped(node: Node, key: Any, rng: random.Random) -> None:
    for _ in range(rng.choice([1, 2, 5, 60])):
        node[key] = rng.choice([[node[key]], {"type": node[key]}, {"a": node[key]}])


def swapped(node: Node, key: Any, rng: random.Random) -> None:
    other = rng.choice(list(node) if isinstance(node, dict) else range(len(node)))
    node[key], node[other] = node[other], node[key]


TREE: list[Callable[[Node, Any, random.Random], None]] = [dropped, doubled, retyped, renumbered, wrapped, swapped]


def line_doubled(lines: list[str], at: int, _: random.Random) -> None:
    lines.insert(at, lines[at])


def line_indented(lines: list[str], at: int, rng: random.Random) -> None:
    lines[at] = rng.choice([" ", "  ", "\t", "- ", "? "]) + lines[at]


def letter_put_in(lines: list[str], at: int, rng: random.Random) -> None:
    where = rng.randrange(len(lines[at]) + 1)
    letters = "{}[]:,#&*!|>'\"%@`-?\\\t\x00\x07\x85\u00a0\ufeff\u2028\ufffe\U0001f600"
    letter = rng.choice([*letters, "<<: ", "%YAML 9\n"])
    lines[at] = lines[at][:where] + letter + lines[at][where:]


def anchored(lines: list[str], at: int, rng: random.Random) -> None:
    lines[at] = re.sub(r": ", f": &a{rng.randrange(2)} ", lines[at], count=1)
    other = rng.randrange(len(lines))
    lines[other] = re.sub(r": .*", rng.choice([": *a0", ": *a1", ": {<<: *a0}", ": [*a0, *a0]"]), lines[other], count=1)


def line_cut(lines: list[str], at: int, rng: random.Random) -> None:
    del lines[at:]


LINES: list[Callable[[list[str], int, random.Random], None]] = [
    line_doubled, line_indented, letter_put_in, letter_put_in, anchored, anchored, line_cut,
]  # fmt: skip


def mutated(seed: int) -> str:
    """A spec of ours with one to three random changes."""
    rng = random.Random(seed)
    text = rng.choice(TEXTS)
    if rng.random() < 0.6:
        tree = YAML(typ="safe").load(text)
        for _ in range(rng.choice([1, 1, 2, 3])):
            found = list(places(tree))
            if found:
                rng.choice(TREE)(*rng.choice(found), rng)
        stream = io.StringIO()
        yaml = YAML()
        yaml.allow_duplicate_keys = True
        yaml.dump(tree, stream)
        return stream.getvalue()
    lines = text.splitlines()
    for _ in range(rng.choice([1, 1, 2, 3])):
        rng.choice(LINES)(lines, rng.randrange(max(1, len(lines))), rng) if lines else None
    return "\n".join(lines)


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plugins are loaded once."""
    registry = Registry.load()
    monkeypatch.setattr(Registry, "load", lambda *_: registry)


def check(numbers: range, folder: Path) -> int:
    """Check many specs; how many were refused."""
    path, refused = folder / "spec.yaml", 0
    for number in numbers:
        path.write_text(mutated(number), encoding="utf-8", errors="surrogatepass")
        done = CliRunner().invoke(app, ["check", str(path)])
        if done.exit_code:
            refused += 1
            assert done.exit_code == 2, (number, done.exception)
            assert re.fullmatch(rf"error: {re.escape(str(path))}:\d+: .+\n", done.stderr), (number, done.stderr)
    return refused


@pytest.mark.parametrize(
    ("first", "many"),
    [
        (140, 60),  # one of these has a mapping for a key
        pytest.param(200, 200, marks=pytest.mark.tools),
        pytest.param(400, 5000, marks=pytest.mark.sweep),
    ],
)
def test_specs_changed_at_random_are_refused_with_their_line(first: int, many: int, tmp_path: Path) -> None:
    refused = check(range(first, first + many), tmp_path)
    assert many / 2 < refused < many
