"""Lint, types and import layers, and rules of the project that no tool knows, so that one command checks all."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parent.parent
TOOLS = {
    "lint": [sys.executable, "-m", "ruff", "check", "."],
    "layout": [sys.executable, "-m", "ruff", "format", "--check", "magiclens"],
    "layers": [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"],
}
TYPES = [sys.executable, "-m", "mypy"]
MOST_PARAMETERS = 8
MOST_OPTIONS = 11  # of a command, which are written by name
SOURCES = sorted([*ROOT.glob("magiclens/**/*.py"), *ROOT.glob("plugins/mlens-*/src/**/*.py")])


@pytest.mark.parametrize("tool", [*TOOLS, pytest.param("types", marks=pytest.mark.tools)])
def test_the_code_passes(tool: str) -> None:
    command = {**TOOLS, "types": TYPES}[tool]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_no_file_imports_itself_by_way_of_others() -> None:
    """Imports inside functions, and those for type checkers only, count too."""
    graph = grimp.build_graph("magiclens", cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert len(imports) > 200
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Where each function is, and the function."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                yield f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}", node


def test_no_function_has_more_parameters_than_one_can_tell_apart() -> None:
    found = []
    for where, function in functions():
        names = [a.arg for a in (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)]
        most = MOST_OPTIONS if function.name.endswith("_command") else MOST_PARAMETERS
        if len(names) - (names[:1] in (["self"], ["cls"])) > most:
            found.append(where)
    assert not found


def test_no_public_name_means_two_things() -> None:
    """Hooks aside, which plugins implement under the hook's name."""
    homes: dict[str, list[str]] = defaultdict(list)
    for path in SOURCES:
        if path.is_relative_to(ROOT / "magiclens"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                for name in public_names(node):
                    homes[name].append(str(path.relative_to(ROOT)))
    assert len(homes) > 500
    assert {name: places for name, places in homes.items() if len(places) > 1} == {}


def test_no_test_replaces_a_private_name() -> None:
    """What a test replaces, others may replace, too: it has a public name."""
    found = []
    for path in (*ROOT.glob("tests/**/*.py"), *ROOT.glob("plugins/*/tests/**/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "setattr":
                names = [n.value for n in node.args[:2] if isinstance(n, ast.Constant) and isinstance(n.value, str)]
                if any(word.startswith("_") and not word.startswith("__") for n in names for word in n.split(".")):
                    found.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not found


def public_names(node: ast.stmt) -> list[str]:
    """What a statement of a module defines for others."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        names = [node.name]
    elif isinstance(node, ast.Assign):
        names = [target.id for target in node.targets if isinstance(target, ast.Name)]
    elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        names = [node.target.id]
    else:
        names = []
    return [name for name in names if not name.startswith(("_", "mlens_"))]
