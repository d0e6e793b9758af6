"""Plugins that are written by others: the template and the how-to page make packages whose contract tests pass."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from copier import run_copy

from magiclens import CONTRACT
from magiclens.contract.stages import KINDS

ROOT = Path(__file__).parent.parent
ALL_KINDS = (*KINDS, "scenario", "art", "executor")
HOW_TO = ROOT / "docs" / "how-to" / "write-a-plugin.md"


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The template as the repository has it now, committed or not."""
    folder = tmp_path_factory.mktemp("template")
    shutil.copy(ROOT / "copier.yml", folder)
    shutil.copytree(ROOT / "plugins" / "template", folder / "plugins" / "template")
    return folder


def generated(template: Path, folder: Path, **answers: Any) -> Path:
    run_copy(str(template), folder, data={"author": "Ada Lovelace", **answers}, defaults=True, quiet=True)
    return folder


def written(folder: Path) -> Path:
    """The plugin of the how-to page."""
    folder.mkdir()
    for name, code in re.findall(r"^```\w+\n# (\S+\.\w+)\n(.*?)^```", HOW_TO.read_text(), re.MULTILINE | re.DOTALL):
        (folder / name).write_text(code)
    return folder


@pytest.fixture(scope="module")
def plugins(template: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One plugin of each kind, and that of the page under a name of its own."""
    folder = tmp_path_factory.mktemp("plugins")
    for kind in ALL_KINDS:
        generated(template, folder / kind, kind=kind, **({"type": "off-too"} if kind == "exporter" else {}))
    written(folder / "page")
    return folder


@pytest.fixture(scope="module")
def site(plugins: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of them installed by pip, without access to the network."""
    site = tmp_path_factory.mktemp("site")
    sources = [shutil.copytree(p, site.parent / "sources" / p.name) for p in sorted(plugins.iterdir())]
    quiet = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "install", *quiet, "--target", site]
    subprocess.run([*pip, *sources], check=True, timeout=300)
    return site


def run(site: Path, *arguments: str | Path) -> str:
    command = [sys.executable, "-m", *map(str, arguments)]
    env = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.tools
def test_the_contract_tests_of_every_generated_plugin_are_green(plugins: Path, site: Path) -> None:
    flags = ["-q", "-rA", "--import-mode=importlib", "-p", "no:cacheprovider", f"--rootdir={plugins}"]
    said = run(site, "pytest", *flags, plugins)
    passed = re.findall(r"^PASSED .*?(\w+)(?:/tests)?/test_\w+\.py::(\w+)", said, re.MULTILINE)
    for kind in (*ALL_KINDS, "page"):
        names = [name for project, name in passed if project == kind]
        assert sum(name.startswith("Test") for name in names) >= (8 if kind in (*KINDS, "page") else 3)
        assert kind == "page" or sum("can_be_picked" in name or "can_pick_it" in name for name in names) == 1


@pytest.mark.tools
def test_every_generated_plugin_is_listed_with_its_package(site: Path) -> None:
    listing = run(site, "magiclens", "plugins")
    assert "failures" not in listing
    rows = {tuple(line.split()[:4]) for line in listing.splitlines()}
    assert ("exporter", "off-too", "mlens-off-too", "0.1.0") in rows
    assert ("exporter", "off", "mlens-off", "0.1.0") in rows
    assert {row[0] for row in rows if row[2:] and row[2].startswith("mlens-")} >= set(ALL_KINDS)


def test_a_generated_plugin_has_what_a_repository_needs(plugins: Path) -> None:
    folder = plugins / "matcher"
    assert "Copyright (c) Ada Lovelace" in (folder / "LICENSE").read_text()
    assert "`random-search`" in (folder / "README.md").read_text()
    assert "python-version: ${{ matrix.python }}" in (folder / ".github" / "workflows" / "tests.yml").read_text()
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["entry-points"] == {"magiclens": {"random-search": "mlens_random_search"}}
    assert f'mlens_contract = "{CONTRACT}"' in (folder / "src" / "mlens_random_search" / "__init__.py").read_text()
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert not {name for name in names if "{" in name or name.endswith(".jinja")}


def test_every_question_has_an_answer_to_begin_with(template: Path, tmp_path: Path) -> None:
    run_copy(str(template), tmp_path / "out", defaults=True, quiet=True)
    assert "Copyright (c) the authors of mlens-off" in (tmp_path / "out" / "LICENSE").read_text()


def test_generated_code_is_tidy(plugins: Path) -> None:
    rules = ["--isolated", "--line-length=120", "--select=E,F,W,I,B,UP", '--config=src = ["src"]']
    ruff = [sys.executable, "-m", "ruff", "check", *rules]
    for kind in ALL_KINDS:
        done = subprocess.run(ruff, cwd=plugins / kind, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    "answers", [{"name": "My Plugin"}, {"name": "mlens_off"}, {"type": "Off"}, {"kind": "painter"}, {"author": " "}]
)
def test_answers_that_make_no_package_are_refused(answers: dict[str, str], template: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=next(iter(answers))):
        generated(template, tmp_path / "out", **answers)
    assert not (tmp_path / "out").exists()


def test_the_page_builds_its_plugin_in_less_than_60_lines(tmp_path: Path) -> None:
    folder = written(tmp_path / "page")
    assert {p.name for p in folder.iterdir()} == {"pyproject.toml", "mlens_off.py", "test_off.py"}
    lines = [line for p in folder.iterdir() for line in p.read_text().splitlines() if line.strip()]
    assert len(lines) < 60


def test_the_pages_name_the_contract_that_there_is() -> None:
    assert f'mlens_contract = "{CONTRACT}"' in HOW_TO.read_text()
    assert f'`magiclens.CONTRACT` is `"{CONTRACT}"`' in (ROOT / "docs" / "reference" / "stability.md").read_text()
