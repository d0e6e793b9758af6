"""Broken plugins of many kinds, really installed, all at once: each is named, and everything else goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from magiclens.contract.hookspecs import CONTRACT
from test_registry import install

EXPORTER = """
from magiclens import Exporter, hookimpl

class Mine(Exporter):
    type = "mine"
    suffix = ".mine"

    def export(self, scene, solid, path):
        WORK

@hookimpl
def mlens_stages():
    return [Mine]
"""
RENDERER = """
import numpy as np
from magiclens import Renderer, hookimpl

class Mine(Renderer):
    type = "TYPE"

    def render(self, scene, solid, progress=None):
        return [np.full((32, 32, 1), VALUE) for view in scene.views]

@hookimpl
def mlens_stages():
    return [Mine]
"""
PRINT = "import os, sys; print('garbage'); os.write(1, b'raw garbage\\n'); os.system('echo garbage of a child')"
PRINTER = EXPORTER.replace('"mine"', '"printer"').replace(".mine", ".printer")
BROKEN = {
    "fails-to-import": "import no_such_module",
    "exits-at-import": "raise SystemExit(3)",
    "ends-at-import": "import os; os._exit(0)",
    "wrong-signature": EXPORTER.replace("mlens_stages()", "mlens_stages(everything)"),
    "raises-in-stage": EXPORTER.replace('"mine"', '"raising"').replace("WORK", "raise SystemExit(4)"),
    "returns-nan": RENDERER.replace("TYPE", "nan").replace("VALUE", "np.nan"),
    "prints-garbage": PRINT + PRINTER.replace("WORK", f"{PRINT}; path.write_text('x')"),
}
AT_LOAD = {
    "fails-to-import": "No module named 'no_such_module'",
    "exits-at-import": "SystemExit: 3",
    "ends-at-import": "it called os._exit(0)",
    "wrong-signature": "everything",
}
MORE = {
    "ends-in-stage": "from os import _exit" + EXPORTER.replace('"mine"', '"ending"').replace("WORK", "_exit(0)"),
    "raises-no-exception": "class Odd(BaseException): pass\nraise Odd('odd')",
    "is-too-new": f"mlens_contract = '9.0'\n{EXPORTER}",
    "returns-shapes": RENDERER.replace("TYPE", "shapes").replace("(32, 32, 1)", "(32, 31, 3)").replace("VALUE", "0.5"),
    "copies-ply": EXPORTER.replace('"mine"', '"ply"').replace(".mine", ".ply"),
}
SPEC = """\
scenario: {type: single, source: {type: circles, seed: 7}, target: {art: heart}}
lens: {size: 12mm, facets: 3, microfacets: 4, thickness: 20mm}
pipeline:
  matcher: {type: exhaustive, candidates: 4, polish: 1}
  renderers: [{type: tracer, resolution: 48}]
report: {analyses: []}
"""
Mlens = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all of them."""
    folder = tmp_path_factory.mktemp("site")
    for number, (name, source) in enumerate({**BROKEN, **MORE}.items()):
        install(folder, name, source, f"1.{number}")
    return folder


@pytest.fixture
def mlens(site: Path, tmp_path: Path) -> Mlens:
    """The real program in a process of its own, with the broken plugins on its path or without."""
    (tmp_path / "tiny.yaml").write_text(SPEC)

    def call(*arguments: str, broken: bool = True, **environment: str) -> subprocess.CompletedProcess[str]:
        env = {**os.environ, "PYTHONPATH": str(site) if broken else "", **environment}
        command = [sys.executable, "-m", "magiclens", *arguments]
        return subprocess.run(
            command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300, check=False
        )  # fmt: skip

    return call


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of runs that take the sound stages' results from one another."""
    return {"MLENS_CACHE_SIZE": "100MB", "MLENS_CACHE_DIR": str(tmp_path_factory.mktemp("kept"))}


def artifacts(folder: Path) -> dict[str, str]:
    listed: list[dict[str, Any]] = json.loads((folder / "manifest.json").read_text())["artifacts"]
    return {file["path"]: file["sha256"] for file in listed}


def versioned(name: str) -> str:
    return f"{name} 1.{[*BROKEN, *MORE].index(name)}"


@pytest.mark.tools
def test_a_run_that_uses_none_of_them_gives_the_same_bytes(mlens: Mlens, tmp_path: Path) -> None:
    with_them, without = mlens("run", "tiny.yaml", "--out", "a"), mlens("run", "tiny.yaml", "--out", "b", broken=False)
    assert (with_them.returncode, without.returncode) == (0, 0), with_them.stderr + without.stderr
    assert artifacts(tmp_path / "a") == artifacts(tmp_path / "b")
    assert with_them.stdout.replace("a:", "b:") == without.stdout
    for name, reason in AT_LOAD.items():
        (note,) = [line for line in with_them.stderr.splitlines() if line.startswith("note: ") and name in line]
        assert versioned(name) in note
        assert reason in note


def test_the_listing_names_each_with_its_version_and_the_reason(mlens: Mlens) -> None:
    done = mlens("plugins")
    assert done.returncode == 0
    table, failures = done.stdout.split("\nfailures:\n")
    failures, remarks = failures.split("\nremarks:\n")
    for name, reason in {
        **AT_LOAD,
        "raises-no-exception": "Odd: odd",
        "is-too-new": f"it is written for contract 9.0, this magiclens has {CONTRACT}: upgrade magiclens",
    }.items():
        entry = failures.split(f"({versioned(name)}):\n")[1].split("\n(")[0]
        assert reason in entry
    assert f"({versioned('prints-garbage')}):\n    prints while it is loaded: 'garbage'" in remarks
    for name, kind in (("raises-in-stage", "exporter"), ("returns-nan", "renderer"), ("prints-garbage", "exporter")):
        assert any(line.split()[::2][:2] == [kind, name] for line in table.splitlines())
    assert any(line.startswith("exporter") and " ply " in line and " magiclens " in line for line in table.splitlines())


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "pipeline.exporters=[{type: raising}]",
            f"exporter raising ({versioned('raises-in-stage')}) failed: SystemExit: 4",
        ),
        pytest.param(
            "pipeline.exporters=[{type: ending}]",
            f"exporter ending ({versioned('ends-in-stage')}) failed: SystemExit: it called os._exit(0)",
            marks=pytest.mark.tools,
        ),
        pytest.param(
            "pipeline.renderers=[{type: nan}]",
            f"renderer nan ({versioned('returns-nan')}) broke its contract: single has NaN or infinite values",
            marks=pytest.mark.tools,
        ),
        pytest.param(
            "pipeline.renderers=[{type: shapes}]",
            f"renderer shapes ({versioned('returns-shapes')}) broke its contract: "
            "single has shape (32, 31, 3) instead of (32, 32, 1)",
            marks=pytest.mark.tools,
        ),
        (
            "pipeline.exporters=[{type: ply}]",
            f"the stage exporter 'ply' is claimed by magiclens 0.1.0 and {versioned('copies-ply')}; "
            "keep one of them: uninstall the others, or --disable-plugin NAME",
        ),
    ],
)  # fmt: skip
def test_a_run_that_uses_one_ends_with_1_and_names_it(
    override: str, message: str, mlens: Mlens, tmp_path: Path, kept: dict[str, str]
) -> None:
    done = mlens("run", "tiny.yaml", "--out", "c", "--set", override, "--quiet", **kept)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == f"error: {message}"
    assert done.stdout == ""
    assert not (tmp_path / "c").exists()


def test_an_unknown_stage_may_be_one_of_a_plugin_that_failed(mlens: Mlens) -> None:
    done = mlens("check", "tiny.yaml", "--set", "pipeline.exporters=[{type: mine}]")
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert "unknown exporter 'mine'" in last
    assert all(versioned(name) in last for name in AT_LOAD)


@pytest.mark.parametrize("arguments", [["schema"], ["plugins"], ["plan", "tiny.yaml"]])
def test_standard_output_stays_clean(arguments: list[str], mlens: Mlens) -> None:
    done = mlens(*arguments)
    assert done.returncode == 0
    assert "garbage" not in done.stdout.split("remarks:")[0].replace("prints-garbage", "").replace("prints_garbage", "")
    if arguments == ["schema"]:
        assert "exporter-raising" in json.loads(done.stdout)["definitions"]
    who = versioned("prints-garbage")
    wanted = {f"{who}: {text}" for text in ("garbage", "raw garbage", "garbage of a child")}
    assert wanted <= set(done.stderr.splitlines())


def test_what_a_stage_prints_is_named_too(mlens: Mlens, tmp_path: Path, kept: dict[str, str]) -> None:
    done = mlens("run", "tiny.yaml", "--out", "d", "--set", "pipeline.exporters=[{type: printer}]", **kept)
    assert done.returncode == 0
    assert "garbage" not in done.stdout
    who = f"exporter printer ({versioned('prints-garbage')})"
    assert {f"{who}: garbage", f"{who}: raw garbage", f"{who}: garbage of a child"} <= set(done.stderr.splitlines())
    assert (tmp_path / "d" / "lens.printer").read_text() == "x"


@pytest.mark.tools
def test_a_plugin_that_hangs_is_named_and_can_be_disabled(tmp_path: Path) -> None:
    install(tmp_path, "hangs", "import time; time.sleep(600)")
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-m", "magiclens"]
    with subprocess.Popen([*command, "schema"], env=env, stderr=subprocess.PIPE, text=True) as waiting:
        assert waiting.stderr
        note = waiting.stderr.readline()  # the test would hang with the program
        waiting.send_signal(signal.SIGINT)
        assert waiting.stderr.read() == "error: interrupted\n"
    assert waiting.returncode == 130
    assert note == "note: still loading plugin hangs (hangs 2.1); if it never ends: mlens --disable-plugin hangs ...\n"
    told = [*command, *note.split(": mlens ")[1].split(" ...")[0].split(), "schema"]
    assert subprocess.run(told, env=env, capture_output=True, timeout=60, check=False).returncode == 0


@pytest.mark.parametrize("name", ["copies-ply", pytest.param("Copies.PLY", marks=pytest.mark.tools)])
def test_a_disabled_plugin_is_left_alone(name: str, mlens: Mlens) -> None:
    assert mlens("--disable-plugin", name, "check", "tiny.yaml").returncode == 0
    listing = mlens("--disable-plugin", name, "plugins").stdout
    assert f"disabled:\ncopies_ply ({versioned('copies-ply')})" in listing
    assert "claimed twice" not in listing


def test_several_are_disabled_by_options_and_environment_together(mlens: Mlens) -> None:
    two = ["--disable-plugin", "prints-garbage", "--disable-plugin", "exits-at-import"]
    done = mlens(*two, "plugins", MLENS_DISABLE_PLUGINS="copies-ply, is-too-new")
    assert "garbage" not in done.stderr
    disabled = done.stdout.split("\ndisabled:\n")[1].splitlines()
    assert {line.split()[0] for line in disabled} == {"copies_ply", "is_too_new", "prints_garbage", "exits_at_import"}


@pytest.mark.parametrize("command", [["plugins"], ["check", "tiny.yaml"], ["schema"]])
def test_a_plugin_that_is_not_there_cannot_be_disabled(command: list[str], mlens: Mlens) -> None:
    done = mlens("--disable-plugin", "copys-ply", *command)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith(
        "error: --disable-plugin: unknown plugin 'copys-ply'; did you mean 'cop"
    )
    assert done.stdout == ""
