"""What contributors are told, and what their tools are told, agree: runner, hooks, workflows, issue forms, releases."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

import magiclens

ROOT = Path(__file__).parent.parent


def read_yaml(path: str) -> Any:
    return YAML(typ="safe").load((ROOT / path).read_text(encoding="utf-8"))


def project() -> dict[str, Any]:
    read: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return read["project"]


def test_the_changelog_has_this_version_and_what_comes_after_it() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    unreleased, *released = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert unreleased == "Unreleased"
    cited = read_yaml("CITATION.cff")
    assert released[0] == f"{magiclens.__version__} - {cited['date-released']}"
    assert cited["version"] == magiclens.__version__ == project()["version"]
    assert cited["references"][0]["title"] == "The Magic Lens: Refractive Steganography"


def test_the_server_checks_what_contributors_check_on_every_python() -> None:
    jobs = read_yaml(".github/workflows/checks.yml")["jobs"]
    lines = {name: [step["run"] for step in job["steps"] if "run" in step] for name, job in jobs.items()}
    assert jobs["pip"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]
    assert project()["requires-python"] == ">=3.11"
    assert {"pip install '.[test]'", "pytest"} < set(lines["pip"])
    assert "pytest -m tools" in lines["tools"]
    assert {f"mlens-{name}" for name in jobs["plugins"]["strategy"]["matrix"]["plugin"]} == {
        path.parent.name for path in (ROOT / "plugins").glob("*/pyproject.toml")
    }
    (sweep,) = read_yaml(".github/workflows/sweep.yml")["jobs"].values()
    assert sweep["steps"][-1]["run"] == "pytest -m sweep"


def test_everybody_names_the_same_programs() -> None:
    """README, CONTRIBUTING and the workflow: what apt installs for the tests that ask other programs."""
    said = {}
    for path in ("README.md", "CONTRIBUTING.md", ".github/workflows/checks.yml"):
        text = (ROOT / path).read_text(encoding="utf-8")
        said[path] = set(max(re.findall(r"apt(?:-get)? install (?:-y )?([a-z0-9 -]+)", text), key=len).split())
    assert len(set(map(frozenset, said.values()))) == 1, said


@pytest.mark.parametrize("form", ["bug", "idea", "picture"])
def test_issue_forms_ask_with_words_of_their_own(form: str) -> None:
    asked = read_yaml(f".github/ISSUE_TEMPLATE/{form}.yml")
    assert asked["name"]
    assert asked["description"]
    ids = [field["id"] for field in asked["body"]]
    assert len(ids) == len(set(ids))
    for field in asked["body"]:
        assert field["type"] in ("textarea", "dropdown", "input", "checkboxes")
        assert field["attributes"]["label"]
        assert field["type"] != "dropdown" or field["attributes"]["options"]


def test_short_commands_are_those_that_the_page_explains() -> None:
    text = (ROOT / "justfile").read_text(encoding="utf-8")
    recipes = set(re.findall(r"^([a-z]\w*)(?: \*args)?:$", text, re.MULTILINE))
    assert recipes == {"setup", "fast", "test", "tools", "sweep", "lint", "docs", "site"}
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    explained = set(re.findall(r"^\| `just (\w+)` ", page, re.MULTILINE))
    assert explained == recipes - {"setup"}
    for path in re.findall(r"\b(?:tests|docs)/\w+\.py", text):
        assert (ROOT / path).is_file(), path


def test_hooks_before_a_commit_are_the_checks_of_the_suite() -> None:
    (local,) = read_yaml(".pre-commit-config.yaml")["repos"]
    entries = [hook["entry"].split()[0] for hook in local["hooks"]]
    assert entries == ["ruff", "ruff", "mypy", "lint-imports", "python"]
    assert {hook["language"] for hook in local["hooks"]} == {"system"}
