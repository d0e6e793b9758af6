"""Which small faults of the code are found by its tests: mutation testing, a sample at a time.

    python benchmarks/mutants.py [--count 60] [--first 0] [--seed 0] [--check] [FOLDER ...]

A mutant is the code with another operator or number in one place, or without one call. First each test of a folder
runs once by itself, and the lines that it reaches are kept in ``out/reached.json``. Then each mutant meets the tests
that reach its line, quickest first, until one fails, crashes or does not end; so it is killed. Those that survive are
printed at the end, each with its line; a mutant that no test reaches survives at once.

No file is changed and nothing is imported twice: the tests are collected once, and every mutant has a forked copy of
that process, in which functions of its file have other code. So Linux or macOS is needed. Files with compiled
kernels are left out, but for the optics, whose kernels are small enough to run as plain Python.
"""

from __future__ import annotations

import argparse
import ast
import gc
import json
import os
import resource
import select
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from importlib import import_module
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import coverage
import pytest
from _pytest.runner import runtestprotocol

REPOSITORY = Path(__file__).resolve().parents[1]
RECORD = REPOSITORY / "out" / "reached.json"
PATIENCE_S = 900
"""Seconds by the clock after which tests are taken not to end."""
MEMORY_BYTES = 12 * 2**30
"""Of the address space of a test: a mutant may ask for any amount."""


@dataclass(frozen=True)
class Folder:
    """A folder of the package.

    Attributes:
        killed: The share of its mutants that was killed when last measured.
        tests: Test files that reach it.
        compiled: False for files with kernels, which are then tried too, as plain Python.
        slowest_s: Processor time after which a test is left out, since each mutant may need it.
    """

    killed: float
    tests: list[str]
    compiled: bool = True
    slowest_s: float = 20


FOLDERS = {
    "optics": Folder(0.91, ["test_optics.py", "test_eyes.py", "test_few_facets.py"], compiled=False, slowest_s=4),
    "matching": Folder(
        0.86, ["test_matching.py", "test_darts.py", "test_multi_view.py", "test_scenarios.py", "test_secrecy.py"]
    ),
    "integration": Folder(0.84, ["test_integration.py", "test_refine.py", "test_through_process.py"]),
    "encoding": Folder(0.94, ["test_encoding.py", "test_universal_scenarios.py"]),
    "exporting": Folder(
        0.86,
        ["test_mesh_files.py", "test_exchange_files.py", "test_sheet.py", "test_slices.py", "test_jig.py",
         "test_columns.py", "hostile/test_options.py"],
    ),
    "config": Folder(
        0.92,
        ["test_spec.py", "test_plan.py", "test_profiles.py", "test_secrecy.py", "hostile/test_yaml.py",
         "hostile/test_options.py", "hostile/test_numbers.py", "hostile/test_late_errors.py",
         "hostile/test_sandbox.py"],
    ),
}  # fmt: skip
Test = tuple[dict[str, Any], pytest.Item]
"""What is known of a test, and the test."""
OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """One change of a file of the package.

    Attributes:
        file: Below the repository.
        tree: Its syntax tree, of which ``node`` is a part.
        node: What is replaced.
        text: What it is replaced by.
        statement: The first and last line of the statement, or of its head, that is changed.
        name: The same as long as neither its function nor the change does, wherever it moves in the file.
    """

    file: Path
    tree: ast.Module
    node: ast.expr | ast.stmt
    text: str
    statement: tuple[int, int]
    name: str

    def reached(self, lines: dict[str, list[int]]) -> bool:
        """Whether its statement is among some lines, which are given for each file."""
        return any(self.statement[0] <= line <= self.statement[1] for line in lines.get(str(self.file), []))

    def put_in_place(self) -> None:
        """Give the functions of the imported file the changed code; there is no way back."""
        file = str(REPOSITORY / self.file)
        code = compile(_Replacing(self).visit(self.tree), file, "exec", dont_inherit=True)
        codes = {(part.co_qualname, part.co_firstlineno): part for part in codes_in(code)}
        for function in functions_of(self.file):
            place = function.__code__.co_qualname, function.__code__.co_firstlineno
            function.__code__ = codes.get(place, function.__code__)

    def __str__(self) -> str:
        return f"{self.file}:{self.node.lineno}: {ast.unparse(self.node)}  ->  {self.text}"


class _Replacing(ast.NodeTransformer):
    """Replaces one node; a call is left out by a condition, so that its function still needs the same variables."""

    def __init__(self, mutant: Mutant):
        self.mutant = mutant

    def visit(self, node: ast.AST) -> Any:
        old = self.mutant.node
        if node is not old:
            return self.generic_visit(node)
        if isinstance(old, ast.stmt):
            return ast.fix_missing_locations(ast.copy_location(ast.If(ast.Constant(False), [old], []), old))
        new = ast.parse(self.mutant.text, mode="eval").body
        for part in ast.walk(new):
            ast.copy_location(part, old)
        return new


@cache
def functions_of(file: Path) -> list[FunctionType]:
    """All functions of a file of the package that there are once it is imported, whoever holds them."""
    import_module(".".join(file.with_suffix("").parts))
    functions = [known for known in gc.get_objects() if type(known) is FunctionType]
    return [function for function in functions if function.__code__.co_filename == str(REPOSITORY / file)]


def codes_in(code: CodeType) -> Iterator[CodeType]:
    """The code of a module or function, and of all functions in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes_in(constant)


def mutants_of(file: Path, source: str) -> list[Mutant]:
    """All mutants of the functions of a file."""
    tree, found, names = ast.parse(source), [], Counter[str]()
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for statement in function.body:
            for node, lines in inside(statement, (0, 0)):
                for text in changed(node):
                    name = f"{file} {function.name} {ast.unparse(node)} {text}"
                    names[name] += 1
                    found.append(Mutant(file, tree, node, text, lines, f"{name} {names[name]}"))
    return found


def inside(node: ast.AST, lines: tuple[int, int]) -> Iterator[tuple[Any, tuple[int, int]]]:
    """A statement and what is in it, with the lines of the statement; but for functions, messages and types in it."""
    if isinstance(node, ast.FunctionDef | ast.Raise | ast.JoinedStr | ast.Assert):
        return
    if isinstance(node, ast.stmt):
        body = getattr(node, "body", None)
        lines = (node.lineno, max(node.lineno, body[0].lineno - 1) if body else node.end_lineno or node.lineno)
    yield node, lines
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name != "annotation":
                yield from inside(child, lines)


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


def sample(folder: str, seed: int) -> list[Mutant]:
    """All mutants of a folder in an order that the seed chooses; a change elsewhere in the code does not change it."""
    return sorted(
        (m for file in sources(folder) for m in mutants_of(file, (REPOSITORY / file).read_text("utf-8"))),
        key=lambda mutant: sha256(f"{seed} {mutant.name}".encode()).digest(),
    )


def sources(folder: str) -> Iterator[Path]:
    """Files of a folder of the package that are tried."""
    for path in sorted((REPOSITORY / "magiclens" / folder).rglob("*.py")):
        if not FOLDERS[folder].compiled or "njit" not in path.read_text(encoding="utf-8"):
            yield path.relative_to(REPOSITORY)


@dataclass
class Trial:
    """What pytest calls once it has collected a folder's tests: tries mutants with them.

    Attributes:
        folder: Its name.
        mutants: Those to try.
        known: Of each test by its name: seconds and reached lines, and of which state of the sources.
        survivors: Filled by the trial.
    """

    folder: str
    mutants: list[Mutant]
    known: dict[str, Any]
    survivors: list[Mutant] = field(default_factory=list)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Try all mutants; pytest itself has nothing left to run."""
        tests = sorted(self.recorded(session.items), key=lambda test: float(test[0]["seconds"]))
        for file in {mutant.file for mutant in self.mutants}:
            functions_of(file)
        gc.freeze()  # what all children share shall not be copied for them
        if failed := killer_of(None, tests):
            pytest.exit(f"without any mutant, one after the other, this fails: {failed}", 1)
        for number, mutant in enumerate(self.mutants, 1):
            reaching = [test for test in tests if mutant.reached(test[0]["lines"])]
            killer = killer_of(mutant, reaching)
            self.survivors += [] if killer else [mutant]
            fate = f"killed by {killer}" if killer else "SURVIVED" if reaching else "SURVIVED, reached by no test"
            print(f"{self.folder} {number}/{len(self.mutants)} {mutant}: {fate}", flush=True)
        return True

    def recorded(self, items: list[pytest.Item]) -> Iterator[Test]:
        """Tests with what is known of them, those left out that fail or are slow."""
        RECORD.parent.mkdir(exist_ok=True)
        for _, group in groupby(items, lambda item: item.path):
            records = [(self.record(item), item) for item in group]
            RECORD.write_text(json.dumps(self.known), "utf-8")
            for record, item in records:
                if record["seconds"] is None:
                    print(f"left out, fails or is too slow: {item.nodeid}", flush=True)
                else:
                    yield record, item

    def record(self, item: pytest.Item) -> dict[str, Any]:
        """Seconds and reached lines of a test; it runs if its file has changed, or one that it reaches."""
        name = f"{item.nodeid} {'compiled' if FOLDERS[self.folder].compiled else 'plain'}"
        known: dict[str, Any] | None = self.known.get(name)
        if known is None or known["state"] != state_of(item, known["lines"]):
            seconds, lines = in_child(lambda: reached(item), FOLDERS[self.folder].slowest_s) or (None, {})
            known = self.known[name] = {"seconds": seconds, "lines": lines, "state": state_of(item, lines)}
        return known


def state_of(item: pytest.Item, reached: Iterable[str]) -> str:
    """Another text when a test's file says something else, or one of the package that it reaches."""
    return " ".join(digest(path) for path in [item.path, *(REPOSITORY / file for file in sorted(reached))])


@cache
def digest(path: Path) -> str:
    """Of what a file says; empty if it is gone."""
    return sha256(path.read_bytes()).hexdigest()[:12] if path.exists() else ""


def reached(item: pytest.Item) -> tuple[float, dict[str, list[int]]] | None:
    """Seconds that a test takes and the lines of the package that it reaches; None if it fails."""
    files = [f"{REPOSITORY / 'magiclens' / folder}/*" for folder in FOLDERS]
    recorder = coverage.Coverage(data_file=None, config_file=False, include=files)
    began = time.process_time()
    recorder.start()
    passed = passes(item)
    recorder.stop()
    seconds, data = time.process_time() - began, recorder.get_data()
    lines = {str(Path(file).relative_to(REPOSITORY)): sorted(data.lines(file) or []) for file in data.measured_files()}
    return (seconds, lines) if passed else None


def killer_of(mutant: Mutant | None, tests: list[Test]) -> str | None:
    """The first of some tests that does not pass with a mutant; None if all do."""

    def first_that_fails() -> str:
        if mutant:
            mutant.put_in_place()
        for (record, item), following in zip(tests, [*(item for _, item in tests[1:]), None], strict=True):
            signal.setitimer(signal.ITIMER_PROF, 10 + 5 * record["seconds"])  # whose signal ends the process
            if not passes(item, following):
                return str(item.nodeid)
        return ""

    seconds = sum(record["seconds"] for record, _ in tests)
    failed = in_child(first_that_fails, 10 + 5 * seconds) if tests else ""
    return "a test that does not end, or crashes" if failed is None else failed or None


def passes(item: pytest.Item, following: pytest.Item | None = None) -> bool:
    """Run one test; fixtures that the following one does not share end with it."""
    return not any(report.failed for report in runtestprotocol(item, log=False, nextitem=following))


def in_child(work: Callable[[], Any], seconds: float) -> Any:
    """What work returns in a forked copy of this process; None if it crashes or needs more processor time."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            os.setsid()
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
            silent = os.open(os.devnull, os.O_RDWR)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            os.write(writing, json.dumps(work()).encode() + b"\n")
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as end:
        answer = end.readline() if select.select([end], [], [], PATIENCE_S)[0] else b""
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return json.loads(answer or b"null")


def survivors_of(folder: str, mutants: list[Mutant]) -> list[Mutant]:
    """Try mutants of a folder, in a process of its own: what is compiled and collected stays so."""
    context = get_context("fork")
    survivors = context.SimpleQueue()

    def work() -> None:
        os.environ["NUMBA_DISABLE_JIT"] = str(int(not FOLDERS[folder].compiled))
        sys.path.insert(0, str(REPOSITORY))  # before any other installed magiclens
        trial = Trial(folder, mutants, json.loads(RECORD.read_text("utf-8")) if RECORD.exists() else {})
        files = [f"{REPOSITORY}/tests/{name}" for name in FOLDERS[folder].tests]
        arguments = ["-q", "-s", "-n", "0", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
        arguments += ["-m", "not sweep and (not tools or every_third)"]  # all variants of what needs nothing else
        if pytest.main([*arguments, *files], [trial]) == 0:
            survivors.put([mutants.index(mutant) for mutant in trial.survivors])

    process = context.Process(target=work)
    process.start()
    process.join()
    if survivors.empty():
        sys.exit(f"{folder}: pytest ended early")
    return [mutants[k] for k in survivors.get()]


def too_few(folder: str, killed: int, tried: int) -> bool:
    """Whether fewer were killed than the folder's share says; a sample may be unlucky by two standard deviations."""
    share = FOLDERS[folder].killed
    return bool(killed < tried * share - 2 * (tried * share * (1 - share)) ** 0.5)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Which small faults of the code are found by its tests.")
    parser.add_argument("folders", nargs="*", metavar="FOLDER", help=f"of {', '.join(FOLDERS)}; all by default")
    parser.add_argument("--count", type=int, default=60, help="mutants to try, in all; equally many of each folder")
    parser.add_argument("--first", type=int, default=0, help="of each folder, to go on after as many")
    parser.add_argument("--seed", type=int, default=0, help="which of all mutants are tried")
    parser.add_argument("--check", action="store_true", help="fail if fewer are killed than when last measured")
    options = parser.parse_args()
    folders = options.folders or list(FOLDERS)
    survivors, lines, worse = [], [], []
    for folder in folders:
        mutants = sample(folder, options.seed)[options.first :][: -(-options.count // len(folders))]
        alive = survivors_of(folder, mutants)
        killed = len(mutants) - len(alive)
        survivors += alive
        lines.append(f"{folder}: {killed} of {len(mutants)} killed; {FOLDERS[folder].killed:.0%} when last measured")
        worse += [folder] if too_few(folder, killed, len(mutants)) else []
    print("", *survivors, *lines, sep="\n")
    if options.check and worse:
        sys.exit(f"fewer than before: {', '.join(worse)}")


if __name__ == "__main__":
    main()
