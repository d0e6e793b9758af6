"""What magiclens brings along: whose licence each package has, and what works without the one that is GPL."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

BLOCKER = """
import sys

class NoPymeshlab:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "pymeshlab":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NoPymeshlab())
"""
"""A ``sitecustomize`` module, so that processes which a run starts have no pymeshlab either."""

SPEC = """scenario:
  type: single
  source: {type: circles}
  target: {art: panda}
lens: {size: 20mm, facets: 4, microfacets: 4, thickness: 10mm, relief: 4mm}
pipeline:
  matcher: {type: exhaustive, step: 0.5mm, candidates: 4, polish: 4}
  renderers: [{type: tracer, resolution: 64}]
report: {analyses: []}
"""

ALLOWED = re.compile(
    r"\b(MIT|MIT-CMU|BSD|0BSD|Apache|ISC|PSF|Python Software Foundation|Zlib|CC0|Mozilla Public License 2|MPL-2)\b"
)
"""Licences that ask for no more than to be named, and MPL 2, which concerns changed files alone."""

KNOWN = {"pymeshlab": "GPL"}
"""Packages with another licence, which the README names."""


def without_pymeshlab(tmp_path: Path, *command: str) -> subprocess.CompletedProcess[str]:
    (tmp_path / "sitecustomize.py").write_text(BLOCKER)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    return subprocess.run(
        [sys.executable, *command], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600
    )


def written(tmp_path: Path, finisher: str = "") -> str:
    spec = tmp_path / "a.yaml"
    spec.write_text(SPEC.replace("  renderers", f"  finisher: {finisher}\n  renderers") if finisher else SPEC)
    return spec.name


def test_the_blocker_blocks(tmp_path: Path) -> None:
    done = without_pymeshlab(tmp_path, "-c", "import pymeshlab")
    assert "No module named 'pymeshlab'" in done.stderr


def test_plan_without_pymeshlab_has_the_free_finisher(tmp_path: Path) -> None:
    shipped = Path(__file__).parent.parent / "specs" / "rotating.yaml"
    done = without_pymeshlab(tmp_path, "-m", "magiclens", "plan", str(shipped))
    assert done.returncode == 0, done.stderr
    assert "finisher manifold (magiclens" in done.stdout


@pytest.mark.parametrize("finisher", ["{type: pymeshlab}", "{smoothing: 1um}"])
def test_pymeshlab_by_name_is_refused_with_the_remedy(tmp_path: Path, finisher: str) -> None:
    done = without_pymeshlab(tmp_path, "-m", "magiclens", "check", written(tmp_path, finisher))
    assert done.returncode == 2
    remedy = "pymeshlab is not installed: pip install pymeshlab"
    assert done.stderr.startswith(f"error: a.yaml:8: pipeline.finisher: {remedy}")
    assert "{type: manifold}" in done.stderr


@pytest.mark.tools
def test_run_without_pymeshlab_writes_the_same_mesh(tmp_path: Path) -> None:
    command = ["-m", "magiclens", "run", written(tmp_path), "--no-cache", "--out"]
    alone = without_pymeshlab(tmp_path, *command, "alone")
    assert alone.returncode == 0, alone.stderr
    assert alone.stderr.count("pymeshlab") == 1
    assert "note: pymeshlab is not installed: the finisher is manifold" in alone.stderr
    subprocess.run([sys.executable, *command, "both"], cwd=tmp_path, check=True, capture_output=True, timeout=600)
    names = [tmp_path / folder / "lens.stl" for folder in ("alone", "both")]
    assert names[0].read_bytes() == names[1].read_bytes()
    stages = [json.loads(name.with_name("manifest.json").read_text())["stages"] for name in names]
    assert [each[3]["type"] for each in stages] == ["manifold", "pymeshlab"]


@pytest.mark.tools
def test_the_free_finisher_keeps_the_contract_without_pymeshlab(tmp_path: Path) -> None:
    test = f"{Path(__file__).with_name('test_contracts.py')}::TestManifold"
    done = without_pymeshlab(tmp_path, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", test)
    assert done.returncode == 0, done.stdout


@pytest.mark.tools
def test_every_package_that_is_brought_along_has_a_licence_that_asks_little() -> None:
    found = brought_along("magiclens")
    assert {"numpy", "pymeshlab", "mitsuba"} <= set(found)  # the search has gone somewhere
    odd = {name: text for name, package in found.items() if not asks_little(text := licence(package))}
    assert {name for name in odd if KNOWN.get(name, "?") not in odd[name]} == set(), odd
    readme = (Path(__file__).parent.parent / "README.md").read_text()
    assert all(f"{name}, is {short}" in readme for name, short in KNOWN.items())


def test_gpl_is_not_among_the_allowed() -> None:
    refused = ["GPL-3.0-only", "GNU General Public License v3", "AGPL-3.0", "", "UNKNOWN", "MIT AND GPL-2.0-or-later"]
    assert not any(map(asks_little, refused))
    assert all(map(asks_little, ["MIT", "BSD-3-Clause", "Apache Software License", "MIT AND PSF-2.0", "GPL-2 OR MIT"]))


def brought_along(name: str) -> dict[str, Distribution]:
    """The packages that pip installs with one, by name; extras are left out."""
    found: dict[str, Distribution] = {}
    waiting = [name]
    while waiting:
        try:
            package = distribution(waiting.pop())
        except PackageNotFoundError:  # of another platform, or not needed with this version of Python
            continue
        if package.metadata["Name"] not in found:
            found[package.metadata["Name"]] = package
            needs = map(Requirement, package.requires or ())
            waiting += [need.name for need in needs if need.marker is None or need.marker.evaluate({"extra": ""})]
    return {name.lower(): package for name, package in found.items()}


def asks_little(text: str) -> bool:
    """Whether a licence is allowed: each of those that hold together, one of those to choose from."""
    return all(ALLOWED.search(part) for part in text.split(" AND "))


def licence(package: Distribution) -> str:
    """What a package's metadata says: its SPDX expression, else its classifiers, else the first line of its text."""
    data = package.metadata
    classifiers = [line for line in data.get_all("Classifier", []) if line.startswith("License ::")]
    text = (data["License"] or "").strip().splitlines()
    return data["License-Expression"] or " AND ".join(classifiers) or (text[0] if text else "")
