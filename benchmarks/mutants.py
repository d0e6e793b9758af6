"""Which small faults of the code are found by its tests: mutation testing, a sample at a time.

    python benchmarks/mutants.py [--count 60] [--seed 0] [FOLDER ...]

A mutant is a copy of the code in which one operator, number or call is another. It is killed if the tests of its folder
fail or do not end; those that survive are printed at the end, each with its line. The tests are the quick ones, and the
working tree is not touched. Files with compiled kernels are left out: every mutant would be compiled for minutes.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
TESTS = {
    "matching": ["test_matching", "test_darts", "test_multi_view", "test_contracts"],
    "integration": ["test_integration", "test_refine", "test_through_process", "test_contracts"],
    "encoding": ["test_encoding"],
    "exporting": ["test_mesh_files", "test_exchange_files", "test_sheet", "test_slices", "test_contracts"],
    "config": ["test_spec", "test_plan", "test_profiles", "hostile/test_yaml", "hostile/test_options"],
}
"""Test files of each folder of the package."""
LONGEST_S = 600
"""Seconds after which tests are taken not to end."""
OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """One change: at these lines and columns of a file of the package, this text is replaced."""

    file: Path
    node: ast.expr | ast.stmt
    text: str

    def applied(self, source: str) -> str:
        """The file's text with the change; columns are counted in UTF-8."""
        lines = [line.encode() for line in source.splitlines(keepends=True)]
        first, last = self.node.lineno - 1, (self.node.end_lineno or 0) - 1
        before = b"".join([*lines[:first], lines[first][: self.node.col_offset]])
        after = b"".join([lines[last][self.node.end_col_offset :], *lines[last + 1 :]])
        return (before + self.text.encode() + after).decode()

    def __str__(self) -> str:
        return f"{self.file}:{self.node.lineno}: {ast.unparse(self.node)}  ->  {self.text}"


def mutants_of(file: Path, source: str) -> Iterator[Mutant]:
    """All mutants of the functions of a file."""
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef):
            for statement in function.body:
                for node in inside(statement):
                    yield from (Mutant(file, node, text) for text in changed(node))


def inside(node: ast.AST) -> Iterator[ast.AST]:
    """A statement and what is in it, but for functions in it, messages and types."""
    if isinstance(node, ast.FunctionDef | ast.Raise | ast.JoinedStr | ast.Assert):
        return
    yield node
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name != "annotation":
                yield from inside(child)


def changed(node: ast.AST) -> Iterator[str]:
    """Texts that a node may be replaced by."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        yield f"({ast.unparse(ast.Compare(node.left, [OPERATORS[type(node.ops[0])]()], node.comparators))})"  # type: ignore[list-item]
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        yield f"({ast.unparse(ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right))})"  # type: ignore[arg-type]
    elif isinstance(node, ast.BoolOp):
        yield f"({ast.unparse(ast.BoolOp(OPERATORS[type(node.op)](), node.values))})"  # type: ignore[arg-type]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield ast.unparse(node.operand)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield str(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield repr(node.value + 1 if isinstance(node.value, int) else node.value * 1.5 or 1.0)
    elif isinstance(node, ast.Name) and node.id in NAMES:
        yield NAMES[node.id]
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield f"{ast.unparse(node.value)}.{NAMES[node.attr]}"
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "pass"


def survives(mutant: Mutant | None, copy: Path, tests: list[str]) -> bool:
    """Whether tests pass in a copy of the repository, with a mutant in it or without."""
    kept = None
    if mutant:
        kept = (copy / mutant.file).read_text(encoding="utf-8")
        (copy / mutant.file).write_text(mutant.applied(kept), encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    files = [f"tests/{name}.py" for name in tests]
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    try:
        done = subprocess.run(
            [*command, *files], cwd=copy, env=environment, capture_output=True, timeout=LONGEST_S, check=False
        )
        return done.returncode == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        if mutant and kept is not None:
            (copy / mutant.file).write_text(kept, encoding="utf-8")


def sources(folders: list[str]) -> Iterator[Path]:
    """Files of some folders of the package that have no compiled kernels."""
    for folder in folders:
        for path in sorted((REPOSITORY / "magiclens" / folder).glob("*.py")):
            text = path.read_text(encoding="utf-8")
            if "njit" not in text and "NamedTuple" not in text:
                yield path.relative_to(REPOSITORY)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Which small faults of the code are found by its tests.")
    parser.add_argument("folders", nargs="*", metavar="FOLDER", help=f"of {', '.join(TESTS)}; all by default")
    parser.add_argument("--count", type=int, default=60, help="mutants to try")
    parser.add_argument("--seed", type=int, default=0, help="which of all mutants are tried")
    options = parser.parse_args()
    folders = options.folders or list(TESTS)
    rng, survivors = random.Random(options.seed), []
    per_folder = {
        folder: [m for file in sources([folder]) for m in mutants_of(file, (REPOSITORY / file).read_text("utf-8"))]
        for folder in folders
    }
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch, "copy")
        shutil.copytree(REPOSITORY, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", "out", "*.egg-info"))
        for number in range(options.count):
            # folder by folder, so that small ones get as many as large ones
            folder = folders[number % len(folders)]
            if number < len(folders) and not survives(None, copy, TESTS[folder]):
                sys.exit(f"the tests of {folder} fail without any mutant")
            mutant = per_folder[folder].pop(rng.randrange(len(per_folder[folder])))
            alive = survives(mutant, copy, TESTS[folder])
            survivors += [mutant] if alive else []
            print(f"{number + 1}/{options.count} {'SURVIVED' if alive else 'killed'}  {mutant}", flush=True)
    print(f"\n{options.count - len(survivors)} of {options.count} killed; survivors:", *survivors, sep="\n")


if __name__ == "__main__":
    main()
