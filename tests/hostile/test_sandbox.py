"""Files outside of a spec's folder are said aloud, listed in the manifest, and refused with ``--sandbox``."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from magiclens.cache.store import Cache
from magiclens.cli import app
from magiclens.contract.errors import InputError
from magiclens.images.files import write_png
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.pipeline import kept_run, run_plan
from toys import SPEC


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder for a spec, with a picture inside, one outside, and links that lead out and in."""
    spec_folder = tmp_path / "specs"
    spec_folder.mkdir()
    for k, place in enumerate((spec_folder / "inside.png", tmp_path / "outside.png")):
        write_png(place, np.full((40, 40, 1), 0.2 + 0.3 * k, np.float32))
    (spec_folder / "link.png").symlink_to(tmp_path / "outside.png")
    (spec_folder / "way").symlink_to(tmp_path)
    (tmp_path / "back.png").symlink_to(spec_folder / "inside.png")
    return spec_folder


def written(folder: Path, target: str) -> Path:
    spec = folder / "toy.yaml"
    spec.write_text(SPEC.replace("{art: panda}", f"{{image: '{target}'}}"))
    return spec


def installed(folder: Path, target: str) -> Path:
    """A spec of stages that are installed."""
    spec = folder / "a.yaml"
    spec.write_text(f"scenario:\n  type: single\n  source: {{type: circles}}\n  target:\n    image: '{target}'\n")
    return spec


OUTSIDE = ["../outside.png", "{above}/outside.png", "link.png", "way/outside.png", "../specs/../outside.png"]
INSIDE = ["inside.png", "./inside.png", "../specs/inside.png", "{above}/specs/inside.png", "way/specs/inside.png"]


@pytest.mark.parametrize("target", OUTSIDE)
def test_a_file_outside_is_refused_with_its_line(target: str, folder: Path, registry: Registry) -> None:
    target = target.format(above=folder.parent)
    spec = written(folder, target)
    assert load_plan(spec, [], registry).notices() == (f"files outside of the spec's folder are read: '{target}'",)
    with pytest.raises(InputError) as raised:
        load_plan(spec, [], registry, sandbox=True)
    place = f"{spec}:4: scenario.targets.0.image"
    assert str(raised.value).startswith(f"{place}: '{target}' is outside of the spec's folder")


@pytest.mark.parametrize("target", [*INSIDE, "../back.png"])
def test_a_file_inside_is_allowed_whatever_way_leads_there(target: str, folder: Path, registry: Registry) -> None:
    plan = load_plan(written(folder, target.format(above=folder.parent)), [], registry, sandbox=True)
    assert plan.notices() == ()
    assert len(plan.files) == 1


def test_sandbox_does_not_tell_whether_a_file_is_there(folder: Path, registry: Registry) -> None:
    texts = []
    for target in ("../outside.png", "../missing.png"):
        with pytest.raises(InputError) as raised:
            load_plan(written(folder, target), [], registry, sandbox=True)
        texts.append(str(raised.value).replace(target, ""))
    assert texts[0] == texts[1]


@pytest.mark.parametrize("command", ["check", "plan", "run", "sweep --set seed=1,2"])
def test_commands_refuse_it_with_exit_code_2(command: str, folder: Path) -> None:
    spec = installed(folder, "../outside.png")
    name, *more = command.split()
    done = CliRunner().invoke(app, [name, str(spec), "--sandbox", *more])
    assert done.exit_code == 2
    assert f"error: {spec}:5: scenario.target.image: '../outside.png' is outside of the spec's folder" in done.output
    assert sorted(path.name for path in folder.iterdir()) == ["a.yaml", "inside.png", "link.png", "way"]


@pytest.mark.parametrize("command", ["check", "plan"])
def test_without_sandbox_it_is_said_aloud_once(command: str, folder: Path) -> None:
    done = CliRunner().invoke(app, [command, str(installed(folder, "../outside.png"))])
    assert done.exit_code == 0
    assert done.stderr == "note: files outside of the spec's folder are read: '../outside.png'\n"
    assert CliRunner().invoke(app, [command, str(installed(folder, "inside.png"))]).stderr == ""


def test_the_manifest_lists_what_was_read(
    folder: Path, registry: Registry, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = load_plan(written(folder, "../outside.png"), ["scenario.targets.1={image: inside.png}"], registry)
    manifest = run_plan(plan, tmp_path / "out").manifest
    assert capsys.readouterr().err.count("outside of the spec's folder") == 1
    places = tmp_path / "outside.png", folder / "inside.png"
    digest = hashlib.sha256(places[0].read_bytes()).hexdigest()
    assert manifest["inputs"] == [{"path": "../outside.png", "copy": "inputs/outside.png", "sha256": digest}]
    assert (tmp_path / "out" / "inputs" / "inside.png").read_bytes() == places[1].read_bytes()
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["inputs"] == manifest["inputs"]
    assert (tmp_path / "out" / "inputs" / "outside.png").read_bytes() == places[0].read_bytes()


def test_a_kept_run_lists_the_paths_of_its_own_spec(folder: Path, registry: Registry, tmp_path: Path) -> None:
    cache = Cache(tmp_path / "cache", 10**9)
    run_plan(load_plan(written(folder, "../outside.png"), [], registry), tmp_path / "out", cache=cache)
    manifest = kept_run(load_plan(written(folder, "way/outside.png"), [], registry), tmp_path / "again", cache=cache)
    assert manifest is not None
    assert [entry["path"] for entry in manifest["inputs"]] == ["way/outside.png"]


def test_a_run_folder_names_no_file_outside(folder: Path, registry: Registry, tmp_path: Path) -> None:
    run_plan(load_plan(written(folder, "../outside.png"), [], registry), tmp_path / "out")
    again = load_plan(tmp_path / "out" / "spec.yaml", [], registry, sandbox=True)
    assert [*again.files.values()] == ["inputs/outside.png"]
