"""Compiled kernels are kept, and never used once the sources have changed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import magiclens
from lenses import FEW, SMALL, SPECS
from magiclens.kernels.cache_folder import cache_folder
from magiclens.kernels.compiler import njit

PACKAGE = Path(magiclens.__file__).parent
ADD = "from magiclens.kernels.compiler import njit\n\n\n@njit(cache=True)\ndef add(a, b):\n    return a + b\n"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of three files."""
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "plain.py").write_text("x = 1\n", encoding="utf-8")
    (folder / "kernels.py").write_text(ADD, encoding="utf-8")
    (folder / "tuples.py").write_text("class Facets(NamedTuple): ...\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize("file", ["kernels.py", "tuples.py"])
def test_another_state_of_what_kernels_are_made_of_has_another_folder(package: Path, file: str) -> None:
    before = cache_folder(package)
    assert cache_folder(package) == before
    path = package / file
    path.write_text(path.read_text(encoding="utf-8").replace("a", "e"), encoding="utf-8")
    assert cache_folder(package) != before


def test_other_files_make_no_difference(package: Path) -> None:
    before = cache_folder(package)
    (package / "plain.py").write_text("x = 2\n", encoding="utf-8")
    assert cache_folder(package) == before


def test_all_kernels_are_compiled_into_that_folder() -> None:
    importing = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if re.search(r"from numba import[^\n]*jit\b|numba\.n?jit\b", path.read_text(encoding="utf-8"))
    }
    assert importing == {"kernels/compiler.py", "kernels/linking.py"}


@pytest.mark.tools
def test_copies_of_the_package_share_what_is_compiled(tmp_path: Path) -> None:
    """Installed in two virtual environments, or in one and in the clone that ``python -m`` looks into."""
    count = "from magiclens.kernels.add import add\nadd(2, 3)\nprint(*add.stats.cache_hits.values())"
    hits = []
    for place in ("one", "two"):
        kernels = tmp_path / place / "magiclens" / "kernels"
        shutil.copytree(PACKAGE / "kernels", kernels, ignore=shutil.ignore_patterns("__pycache__"))
        (kernels.parent / "__init__.py").touch()
        (kernels / "add.py").write_text(ADD, encoding="utf-8")
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(tmp_path / place)}
        done = subprocess.run(
            [sys.executable, "-P", "-c", count], env=environment, capture_output=True, text=True, check=True
        )
        hits.append(done.stdout.strip())
    assert hits == ["", "1"]


def test_folders_that_nobody_uses_are_removed(tmp_path: Path) -> None:
    old, recent, other = (tmp_path / name for name in ("kernels-old", "kernels-recent", "mine"))
    for folder in (old, recent, other):
        folder.mkdir()
    for folder in (old, other):
        os.utime(folder, (time.time() - 40 * 86400,) * 2)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", "import magiclens.kernels.compiler"], env=environment, check=True)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"kernels-recent", "mine", cache_folder().name}


def test_a_folder_that_cannot_be_made_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "kernel.py").write_text(ADD + "\n\nprint(add(2, 3))\n", encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "file" / "cache")}
    command = [sys.executable, str(tmp_path / "kernel.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "5\n"


def test_a_kernel_does_not_take_its_flags_from_its_caller() -> None:
    """numba compiles a kernel with the flags of the caller that comes first, where the kernel does not say its own."""

    @njit()
    def lost(a, b):
        return (a + b) - b

    @njit(fastmath=True)
    def relaxed(a, b):
        return lost(a, b)

    assert relaxed(1e-20, 1.0) in (0.0, 1e-20)
    assert lost(1e-20, 1.0) == 0.0  # compiled for the caller above
    assert njit()(lambda a, b: a / b)(1.0, 0.0) == np.inf


@pytest.mark.sweep
def test_bytes_do_not_depend_on_what_was_compiled_before(tmp_path: Path) -> None:
    """What another spec needed first is compiled for other types and by other callers."""

    def run(*specs: str) -> Path:
        """The run folder of the last one; all of them in one process with a kernel cache of its own."""
        folder = tmp_path / "-".join(specs)
        lines = ["from magiclens import load_plan", "from magiclens.running.pipeline import run_plan"]
        for spec in specs:
            plan = f"load_plan({str(SPECS / spec)!r} + '.yaml', {(*FEW, *SMALL[spec])})"
            lines.append(f"run_plan({plan}, {str(folder / spec)!r})")
        surroundings = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "kernels"), "MLENS_CACHE_SIZE": "0"}
        subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, env=surroundings, capture_output=True)
        return folder / specs[-1]

    fresh = run("single")
    later = run("printed-single", "multi-view", "rotating-codesign", "single")
    for name in ("heights.npz", "lens.stl", "renders/tracer/single.png"):
        assert (fresh / name).read_bytes() == (later / name).read_bytes()
