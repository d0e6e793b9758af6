"""The command line: what it prints, its exit codes, and how quickly it starts."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator
from typer.testing import CliRunner, Result

from magiclens.cli import app
from magiclens.plan.registry import Plugin, Registry
from toys import SpecWriter, ToyMatcher, plugin_of

HEAVY = {"numba", "scipy", "mitsuba", "pymeshlab", "matplotlib", "skimage"}


@pytest.fixture
def mlens(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Runs a command with the toy plugin installed."""
    monkeypatch.setattr(Registry, "load", lambda: registry)

    def invoke(*arguments: str | Path) -> Result:
        return CliRunner().invoke(app, [str(a) for a in arguments])

    return invoke


def imported(*arguments: str) -> set[str]:
    """Top-level modules that a command imports, in a process of its own."""
    code = (
        "import sys, atexit; from magiclens.cli import main; "
        "atexit.register(lambda: print('IMPORTED', *sys.modules)); main()"
    )
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return {name.split(".")[0] for name in done.stdout.split("IMPORTED")[1].split()}


def test_help_imports_nothing_that_takes_time() -> None:
    modules = imported("--help")
    assert "magiclens" in modules
    assert not modules & (HEAVY | {"numpy", "pydantic", "rich"})


@pytest.mark.parametrize("arguments", [["plugins"], ["schema"]])
def test_nothing_heavy_is_imported_before_stages_run(arguments: list[str]) -> None:
    assert not imported(*arguments) & HEAVY


def test_help_is_quick() -> None:
    command = [sys.executable, "-m", "magiclens", "--help"]
    started = [os.times()]
    for _ in range(3):
        subprocess.run(command, capture_output=True, check=True, timeout=30)
        started.append(os.times())
    used = [
        (b.children_user + b.children_system) - (a.children_user + a.children_system)
        for a, b in itertools.pairwise(started)
    ]
    assert min(used) <= 0.4


def test_help_names_every_command() -> None:
    text = CliRunner().invoke(app, ["--help"]).stdout
    for command in ("run", "check", "plan", "plugins", "schema"):
        assert f"\n  {command} " in text


def test_run_writes_the_folder_and_ends_with_a_summary(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    result = mlens("run", write_spec(), "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "manifest.json").exists()
    assert re.search(r"^as designed +psnr_db", result.stdout, re.MULTILINE)
    assert "rotation-090" in result.stdout
    assert f"{tmp_path / 'out'}: heights.npz, lens.toy, report.html, spec.yaml, manifest.json" in result.stdout
    assert re.search(r"it took \d+\.\d seconds", result.stderr)
    assert "matcher toy" in result.stderr


def test_quiet_runs_say_nothing(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    result = mlens("run", write_spec(), "--out", tmp_path / "out", "--quiet")
    assert (result.exit_code, result.output) == (0, "")


def test_runs_go_to_out_and_the_specs_name_by_default(
    mlens: Any, write_spec: SpecWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert mlens("run", write_spec(), "--set", "name=mine").exit_code == 0
    assert (tmp_path / "out" / "mine" / "manifest.json").exists()


def test_overrides_reach_the_run(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    changes = ["--set", "lens.facets=3", "--set", "seed=9"]
    assert mlens("run", write_spec(), "--out", tmp_path / "out", *changes).exit_code == 0
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert (manifest["scene"]["facets"], manifest["seed"]) == (3, 9)


def test_json_of_a_check_lists_every_mistake_with_its_line(mlens: Any, write_spec: SpecWriter) -> None:
    spec = write_spec(("facets: 4", "facets: 0"), ("sweeps", "swepes"))
    result = mlens("check", spec, "--json")
    assert result.exit_code == 2
    data = json.loads(result.stdout)
    assert data["spec"] == str(spec)
    lines = spec.read_text(encoding="utf-8").splitlines()
    found = [(int(error["where"].rpartition(":")[2]), error["message"]) for error in data["errors"]]
    assert ["facets: 0" in lines[line - 1] or "swepes" in lines[line - 1] for line, _ in found] == [True, True]
    assert any("did you mean 'sweeps'?" in message for _, message in found)
    assert found[0][1] in result.stderr, "the first is the one that people read"
    assert json.loads(mlens("check", write_spec(), "--json").stdout)["errors"] == []


@pytest.mark.parametrize("command", ["run", "check", "plan"])
def test_wrong_input_ends_with_2_and_one_line(command: str, mlens: Any, write_spec: SpecWriter) -> None:
    result = mlens(command, write_spec(("facets: 4", "facets: 0")))
    assert result.exit_code == 2
    assert result.stderr.splitlines() == [f"error: {write_spec()}:8: lens.facets: must be at least 1, got 0"]
    assert result.stdout == ""


@pytest.mark.parametrize(
    "arguments", [["rnu"], ["run"], ["run", "a.yaml", "--owt", "x"], ["check", "a.yaml", "b.yaml"]]
)
def test_wrong_usage_ends_with_2(arguments: list[str], mlens: Any) -> None:
    result = mlens(*arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_a_spec_that_is_not_there_ends_with_2(mlens: Any) -> None:
    result = mlens("run", "nowhere.yaml")
    assert result.exit_code == 2
    assert "there is no file 'nowhere.yaml'" in result.stderr


@pytest.fixture
def crashing(registry: Registry) -> list[str]:
    class Crash(ToyMatcher):
        type = "crash"

        def match(self, *_: Any) -> Any:
            raise RuntimeError("boom")

    registry.register(plugin_of(Crash), Plugin("crash", "crash-package", "0.3"))
    return ["--set", "pipeline.matcher={type: crash}"]


def test_a_failing_stage_ends_with_1_and_its_name(
    mlens: Any, write_spec: SpecWriter, tmp_path: Path, crashing: list[str]
) -> None:
    result = mlens("run", write_spec(), "--out", tmp_path / "out", "--quiet", *crashing)
    assert result.exit_code == 1
    assert result.stderr == "error: matcher crash (crash-package 0.3) failed: RuntimeError: boom\n"
    assert not (tmp_path / "out").exists()


def test_a_traceback_is_shown_on_request(
    mlens: Any, write_spec: SpecWriter, tmp_path: Path, crashing: list[str]
) -> None:
    result = mlens("run", write_spec(), "--out", tmp_path / "out", "--traceback", *crashing)
    assert result.exit_code == 1
    assert "Traceback" in result.stderr
    assert 'raise RuntimeError("boom")' in result.stderr


def test_a_folder_that_cannot_be_written_is_named(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = mlens("run", write_spec(), "--out", tmp_path / "file" / "out")
    assert result.exit_code == 2
    assert "is a file; choose another --out" in result.stderr


def test_check_names_the_views(mlens: Any, write_spec: SpecWriter) -> None:
    path = write_spec()
    assert mlens("check", path).stdout == f"{path}: ok, rotating, views: rotation-000, rotation-090\n"


def test_plan_prints_overridden_options(mlens: Any, write_spec: SpecWriter) -> None:
    result = mlens("plan", write_spec(), "--set", "pipeline.matcher.sweeps=77")
    assert "\n    sweeps: 77\n" in result.stdout


def test_plugins_lists_the_installed_package(mlens: Any) -> None:
    assert "magiclens-toys" in mlens("plugins").stdout


def test_schema_prints_a_draft_7_schema_with_plugins_options(mlens: Any) -> None:
    schema = json.loads(mlens("schema").stdout)
    Draft7Validator.check_schema(schema)
    assert schema["definitions"]["matcher-toy"]["properties"]["sweeps"]["maximum"] == 100
    assert schema["definitions"]["matcher-toy"]["properties"]["window"]["default"] == "10%"
    assert schema["definitions"]["matcher-toy"]["properties"]["step"]["default"] == "0.5mm"


def test_json_of_a_run_is_its_manifest_and_nothing_else(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    result = mlens("run", write_spec(), "--out", tmp_path / "out", "--json")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert json.loads(result.stdout) == {"folder": str(tmp_path / "out"), **manifest}
    assert result.stderr == ""


def test_json_of_a_check_names_the_views(mlens: Any, write_spec: SpecWriter) -> None:
    data = json.loads(mlens("check", write_spec(), "--json").stdout)
    assert data["scenario"] == "rotating"
    assert data["views"] == ["rotation-000", "rotation-090"]


def test_json_of_a_plan_is_the_resolved_spec(mlens: Any, write_spec: SpecWriter) -> None:
    data = json.loads(mlens("plan", write_spec(), "--json", "--set", "lens.facets=3").stdout)
    assert data["lens"]["facets"] == 3
    assert data["pipeline"]["matcher"] == {"type": "toy", "sweeps": 5, "window": "10%", "step": "0.5mm"}


def test_json_of_plugins_names_contributions_and_failures(mlens: Any, registry: Registry) -> None:
    registry.register(plugin_of(3), Plugin("odd", "odd-package", "0.3"))
    data = json.loads(mlens("plugins", "--json").stdout)
    toy = next(one for one in data["contributions"] if (one["kind"], one["name"]) == ("matcher", "toy"))
    assert toy["plugins"] == [{"name": "toys", "package": "magiclens-toys", "version": "1.2"}]
    assert toy["options"] == ["sweeps", "window", "step"]
    assert data["failures"][0]["plugin"]["package"] == "odd-package"


@pytest.mark.parametrize("command", ["run", "plan"])
def test_wrong_input_prints_no_json(command: str, mlens: Any, write_spec: SpecWriter) -> None:
    result = mlens(command, write_spec(("facets: 4", "facets: 0")), "--json")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "lens.facets" in result.stderr


def test_a_quiet_check_says_nothing(mlens: Any, write_spec: SpecWriter) -> None:
    result = mlens("check", write_spec(), "--quiet")
    assert (result.exit_code, result.output) == (0, "")


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("mlens sw", {"sweep"}),
        ("mlens new multi", {"multi-pair", "multi-view"}),
        ("mlens sweep a.yaml --executor s", {"serial"}),
        ("mlens run --qu", {"--quiet"}),
    ],
)
def test_shells_can_complete_what_is_typed(typed: str, offered: set[str]) -> None:
    count = str(len(typed.split()) - 1)
    setting = {"_MLENS_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": count}
    code = "from magiclens.cli import app; app(prog_name='mlens')"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env={**os.environ, **setting}, capture_output=True, text=True, timeout=60)
    assert set(done.stdout.split()) == offered


def test_the_version_is_the_packages() -> None:
    import magiclens

    assert CliRunner().invoke(app, ["--version"]).stdout.strip() == magiclens.__version__


def test_every_public_name_is_there() -> None:
    import magiclens

    for name in magiclens.__all__:
        assert getattr(magiclens, name) is not None
    assert set(magiclens.__all__) <= set(dir(magiclens))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = magiclens.nothing
