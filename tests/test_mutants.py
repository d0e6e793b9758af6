"""Mutation testing finds what tests do not: its mutants are put in place, and tests that fail or hang kill them."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent
SOURCE = """
def doubled(x, most=10):
    if x > most:
        raise ValueError(x + 1)
    note(x)
    return min(2 * x, most)

class Counter:
    def add(self, by):
        def inner(n):
            return n + by
        return inner(1)

def note(x): seen.append(x)
seen = []
"""


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT)
    tool = import_module("benchmarks.mutants")
    monkeypatch.setattr(tool, "REPOSITORY", tmp_path)
    tool.functions_of.cache_clear()
    return tool


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    (tmp_path / "mutated.py").write_text(SOURCE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    sys.modules.pop("mutated", None)
    return import_module("mutated")  # of this test's own folder


@pytest.mark.tools
def test_every_operator_number_and_call_has_a_mutant_but_for_messages(tool: ModuleType) -> None:
    found = [str(mutant) for mutant in tool.mutants_of(Path("mutated.py"), SOURCE)]
    assert found == [
        "mutated.py:3: x > most  ->  (x >= most)",
        "mutated.py:5: note(x)  ->  pass",
        "mutated.py:6: min  ->  max",
        "mutated.py:6: 2 * x  ->  (2 / x)",
        "mutated.py:6: 2  ->  3",
        "mutated.py:14: seen.append(x)  ->  pass",
        "mutated.py:12: 1  ->  2",
        "mutated.py:11: n + by  ->  (n - by)",
    ]


@pytest.mark.tools
def test_a_mutant_is_put_into_functions_that_are_imported_already(tool: ModuleType, module: ModuleType) -> None:
    mutants = {m.text: m for m in tool.mutants_of(Path("mutated.py"), SOURCE)}
    doubled, counter = module.doubled, module.Counter()
    cases = {
        "max": (lambda: doubled(3), 6, 10),
        "(x >= most)": (lambda: doubled(9, 9), 9, None),
        "pass": (lambda: [doubled(3), len(module.seen)][1], 1, 0),
        "(n - by)": (lambda: counter.add(5), 6, -4),
    }
    mutants["pass"] = next(m for m in tool.mutants_of(Path("mutated.py"), SOURCE) if m.node.lineno == 5)
    for text, (work, before, after) in cases.items():
        assert tool.in_child(work, 10) == before
        assert tool.in_child(lambda m=mutants[text], w=work: (m.put_in_place(), w())[1], 10) == after


@pytest.mark.tools
def test_what_does_not_end_or_crashes_gives_nothing(tool: ModuleType) -> None:
    def endless() -> None:
        while True:
            pass

    assert tool.in_child(endless, 0.1) is None
    assert tool.in_child(lambda: 1 / 0, 1) is None
    assert tool.in_child(lambda: list(range(3)), 1) == [0, 1, 2]


@pytest.mark.tools
def test_a_mutant_keeps_its_name_where_code_above_it_changes(tool: ModuleType) -> None:
    names = [m.name for m in tool.mutants_of(Path("a.py"), SOURCE)]
    assert names == [m.name for m in tool.mutants_of(Path("a.py"), "one = 1\n\n" + SOURCE)]
    assert len(set(names)) == len(names)


@pytest.mark.tools
def test_a_mutant_is_reached_by_any_line_of_its_statement(tool: ModuleType) -> None:
    (above, *_) = tool.mutants_of(Path("a.py"), "def f(x):\n    return [\n        x + 1,\n        x,\n    ]\n")
    assert above.reached({"a.py": [4]})
    assert not above.reached({"a.py": [1, 6], "b.py": [3]})


@pytest.mark.tools
def test_fewer_kills_than_last_measured_fail_beyond_chance(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(tool.FOLDERS, "toy", tool.Folder(0.9, []))
    assert not tool.too_few("toy", 90, 100)
    assert not tool.too_few("toy", 85, 100)
    assert tool.too_few("toy", 83, 100)


@pytest.mark.sweep
def test_mutants_are_killed_as_often_as_before() -> None:
    subprocess.run([sys.executable, ROOT / "benchmarks" / "mutants.py", "--count", "60", "--check"], check=True)
