"""``mlens doctor``: what it looks for, what it says about what is missing, and when its exit code is 1."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from typer.testing import CliRunner

from magiclens.cli import app, doctor
from magiclens.cli.doctor import Diagnosis, diagnoses_text, examine, unfit
from magiclens.plan.registry import Plugin, Registry
from toys import plugin_of


@pytest.fixture(autouse=True)
def no_llvm(monkeypatch: pytest.MonkeyPatch) -> None:
    """No LLVM is found, since trying one takes seconds."""
    monkeypatch.setattr("magiclens.rendering.variants.working_llvm", lambda: None)


@pytest.fixture
def found(registry: Registry) -> dict[str, Diagnosis]:
    return {diagnosis.name: diagnosis for diagnosis in examine(registry)}


def test_everything_that_is_needed_is_here(found: dict[str, Diagnosis]) -> None:
    assert not unfit(found.values())
    assert found["numpy"] == Diagnosis("numpy", "ok", version("numpy"), True)
    assert found["font"].status == found["FFmpeg (av)"].status == "ok"
    assert {"python", "magiclens", "plugins", "compiled kernels", "PrusaSlicer", "Chromium"} <= set(found)


def test_every_requirement_is_looked_for_and_no_extra(found: dict[str, Diagnosis]) -> None:
    assert {"numba", "mitsuba", "pymeshlab", "ruamel.yaml", "scipy"} <= set(found)
    assert "pytest" not in found


def test_what_is_missing_says_what_for_and_how_to_get_it(found: dict[str, Diagnosis]) -> None:
    llvm = found["LLVM for Mitsuba"]
    assert (llvm.status, llvm.needed) == ("missing", False)
    assert "apt install libllvm19" in diagnoses_text([llvm]).splitlines()[1]


def test_what_is_well_takes_one_line() -> None:
    well = Diagnosis("numpy", "ok", "2.0", True, "unused")
    assert diagnoses_text([well]).splitlines() == ["ok       numpy            2.0"]


def test_a_program_is_found_on_the_path(registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "admesh"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    programs = {diagnosis.name: diagnosis for diagnosis in examine(registry)}
    assert (programs["admesh"].status, programs["admesh"].found) == ("ok", str(program))
    assert programs["PrusaSlicer"].status == "missing"
    assert not unfit(programs.values())


@pytest.mark.parametrize(
    ("missing", "needed", "told"),
    [("trimesh", True, "pip install trimesh"), ("pymeshlab", False, "the finisher is manifold")],
)
def test_a_package_that_is_missing_makes_it_unfit_if_it_is_needed(
    missing: str, needed: bool, told: str, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    def known(name: str) -> str:
        if name == missing:
            raise PackageNotFoundError
        return version(name)

    monkeypatch.setattr("importlib.metadata.version", known)
    diagnoses = examine(registry)
    assert unfit(diagnoses) == needed
    assert told in diagnoses_text(diagnoses)


def test_a_broken_library_makes_it_unfit(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise OSError("libfreetype is gone")

    monkeypatch.setattr("magiclens.images.text.text", broken)
    diagnoses = examine(registry)
    assert unfit(diagnoses)
    assert "OSError: libfreetype is gone" in diagnoses_text(diagnoses)


def test_a_broken_plugin_is_named_and_does_not_make_it_unfit(registry: Registry) -> None:
    registry.register(plugin_of(3), Plugin("odd", "odd-package", "0.3"))
    diagnoses = {diagnosis.name: diagnosis for diagnosis in examine(registry)}
    assert diagnoses["plugins"].status == "broken"
    assert "odd-package 0.3" in diagnoses["plugins"].found
    assert not unfit(diagnoses.values())


def test_a_cache_that_cannot_be_written_is_reported(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    cache = next(diagnosis for diagnosis in examine(registry) if diagnosis.name == "compiled kernels")
    assert cache.status == "broken"
    assert "NUMBA_CACHE_DIR" in cache.help


def test_the_command_prints_a_table_or_json(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Registry, "load", lambda: registry)
    plain = CliRunner().invoke(app, ["doctor"])
    assert plain.exit_code == 0
    assert "numpy" in plain.stdout
    data = json.loads(CliRunner().invoke(app, ["doctor", "--json"]).stdout)
    assert data["status"] == "ok"
    assert {"name", "status", "found", "needed", "help"} == set(data["findings"][0])


def test_the_command_ends_with_1_when_something_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = Diagnosis("numpy", "missing", "", True, "pip install numpy")
    monkeypatch.setattr(doctor, "examine", lambda _: [missing])
    assert CliRunner().invoke(app, ["doctor"]).exit_code == 1
