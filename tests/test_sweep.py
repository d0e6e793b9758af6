"""Sweeps: which combinations there are, that finished ones stay, and what the sheet says of those that fail."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner, Result

from magiclens.cli import app
from magiclens.contract.artifacts import Assignment, HeightField, Scene
from magiclens.contract.errors import InputError
from magiclens.contract.executors import Processes, Serial
from magiclens.contract.stages import Progress, silent
from magiclens.plan.registry import Registry
from magiclens.sweep.combine import Combination, combinations, split_values
from magiclens.sweep.page import COMBINATION_SIDE, combination_pictures
from magiclens.sweep.results import Sweep
from magiclens.sweep.sweeping import sweep_spec
from toys import TOYS, SpecWriter, ToyIntegrator, no_timings, registry_of

Sweeper = Callable[..., Sweep]


@pytest.fixture
def sweep(write_spec: SpecWriter, registry: Registry, tmp_path: Path) -> Sweeper:
    """Sweeps the toy spec into a folder of that name."""

    def start(*settings: str, out: str = "sweep", stages: Registry = registry, **more: Any) -> Sweep:
        return sweep_spec(write_spec(), settings, tmp_path / out, registry=stages, **more)

    return start


@pytest.fixture
def mlens(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Runs a command with the toy plugin installed."""
    monkeypatch.setattr(Registry, "load", lambda: registry)
    return lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])


class Brittle(ToyIntegrator):
    """Cannot build three facets a side."""

    def integrate(self, scene: Scene, assignment: Assignment, progress: Progress = silent) -> HeightField:
        if scene.lens.facets == 3:
            raise RuntimeError("three <b>is</b> too many")
        return super().integrate(scene, assignment, progress)


@pytest.fixture
def brittle() -> Registry:
    """The toys, with an integrator that fails at times."""
    return registry_of(*(toy for toy in TOYS if toy is not ToyIntegrator), Brittle)


def labels(settings: list[str]) -> list[str]:
    return [one.label for one in combinations(settings)]


def run_folders(done: Sweep) -> set[str]:
    return {path.parent.name for path in done.folder.glob("*/manifest.json")}


def times_of_runs(done: Sweep) -> dict[str, int]:
    return {path.parent.name: path.stat().st_mtime_ns for path in done.folder.glob("*/manifest.json")}


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("16,32, 64", ["16", "32", "64"]),
        ("16", ["16"]),
        ("", [""]),
        ("[a, b]", ["[a, b]"]),
        ("[a, b],[c]", ["[a, b]", "[c]"]),
        ("{type: stl, x: [1, 2]},{type: ply}", ["{type: stl, x: [1, 2]}", "{type: ply}"]),
        ("'a, b',\"c,d\"", ["'a, b'", '"c,d"']),
        ("it's, fine", ["it's", "fine"]),
        ("{name: 'x}, y'}", ["{name: 'x}, y'}"]),
        ("[1, 2", ["[1, 2"]),
    ],
)
def test_commas_part_values_unless_they_are_within_one(text: str, values: list[str]) -> None:
    assert split_values(text) == values


def test_all_combinations_are_made_the_last_key_changing_fastest() -> None:
    found = labels(["lens.facets=16,32", "seed=0,1"])
    assert found == ["facets=16, seed=0", "facets=16, seed=1", "facets=32, seed=0", "facets=32, seed=1"]


def test_keys_with_equal_ends_are_written_out() -> None:
    assert labels(["lens.size=1mm", "scenario.source.size=2mm"]) == ["lens.size=1mm, scenario.source.size=2mm"]


def test_equal_values_are_one() -> None:
    assert labels(["seed=1,1, 1"]) == ["seed=1"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ([], "--set: say what to change, such as --set lens.facets=16,32,64"),
        (["lens.facets"], "--set lens.facets: write key=value,value, such as lens.facets=16,32"),
        (["=3"], "--set =3: write key=value,value, such as lens.facets=16,32"),
        (["seed=1,,2"], "--set seed=1,,2: there is nothing between two commas"),
        (["seed=1", "seed=2"], "--set seed=2: 'seed' is set twice; write all of its values after one --set"),
    ],
)
def test_wrong_settings_are_named(settings: list[str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        combinations(settings)
    assert str(caught.value) == message


def test_folders_have_names_that_can_be_read_and_never_collide() -> None:
    odd = [Combination((("name", value),)).folder for value in ("a/b", "a b", "a:b", "../x", "x" * 300, "ä")]
    assert len(set(odd)) == len(odd)
    assert all(len(name) < 120 and name.isascii() and "/" not in name and name[0] not in ".-" for name in odd)
    assert Combination((("lens.facets", "16"), ("w", "10%"))).folder == "facets=16_w=10%"


def test_every_combination_gets_its_run_folder(sweep: Sweeper) -> None:
    done = sweep("lens.facets=2,3", "seed=1,2")
    assert run_folders(done) == {"facets=2_seed=1", "facets=2_seed=2", "facets=3_seed=1", "facets=3_seed=2"}
    manifest = json.loads((done.folder / "facets=3_seed=2" / "manifest.json").read_text())
    assert (manifest["scene"]["facets"], manifest["seed"]) == (3, 2)
    assert not done.failed


def test_values_can_be_lists_and_mappings(sweep: Sweeper) -> None:
    done = sweep("pipeline.matcher={type: toy, sweeps: 1},{type: toy, sweeps: 2}", "scenario.angles=[0deg, 180deg]")
    made = [result.manifest for result in done.results if result.manifest]
    assert [m["stages"][0]["options"]["sweeps"] for m in made] == [1, 2]
    assert made[0]["views"][1]["rotation_deg"] == 180


def test_finished_combinations_are_not_run_again(sweep: Sweeper) -> None:
    before = times_of_runs(sweep("lens.facets=2,3"))
    said: list[str] = []
    after = times_of_runs(sweep("lens.facets=2,3,4", say=said.append))
    assert said[0] == "3 combinations, 1 to run"
    assert {name: after[name] for name in before} == before
    assert "facets=4" in after


def test_a_sweep_that_is_repeated_writes_the_same_sheet(sweep: Sweeper) -> None:
    first = sweep("lens.facets=2,3")
    sheets = {path.name: path.read_bytes() for path in first.folder.glob("sweep.*")}
    again = sweep("lens.facets=2,3")
    assert {path.name: path.read_bytes() for path in again.folder.glob("sweep.*")} == sheets
    assert sorted(sheets) == ["sweep.csv", "sweep.html", "sweep.json", "sweep.png"]


def grown(folder: Path) -> None:
    (folder / "lens.toy").unlink()


def of_another_version(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["versions"]["numpy"] = "0.0"
    (folder / "manifest.json").write_text(json.dumps(manifest))


def of_another_stage(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["stages"][0]["version"] = "0"
    (folder / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.every_third
@pytest.mark.parametrize("spoil", [grown, of_another_version, of_another_stage])
def test_what_is_no_longer_what_would_be_made_is_made_again(sweep: Sweeper, spoil: Callable[[Path], None]) -> None:
    done = sweep("lens.facets=2,3")
    before = times_of_runs(done)
    spoil(done.folder / "facets=2")
    again = sweep("lens.facets=2,3")
    after = times_of_runs(again)
    assert after["facets=3"] == before["facets=3"]
    assert after["facets=2"] != before["facets=2"]
    assert no_timings(dict(again.results[0].manifest or {})) == no_timings(dict(done.results[0].manifest or {}))


def test_another_constant_value_makes_everything_anew(sweep: Sweeper) -> None:
    sweep("lens.facets=2,3", "seed=1")
    said: list[str] = []
    sweep("lens.facets=2,3", "seed=2", say=said.append)
    assert said[0] == "2 combinations, 2 to run"


def test_a_changed_picture_makes_its_runs_again(
    sweep: Sweeper, grey_png: Path, write_spec: SpecWriter, tmp_path: Path, registry: Registry
) -> None:
    from magiclens.images.files import write_png

    spec = write_spec(("{art: panda}", "{image: grey.png}"))
    said: list[str] = []

    def start() -> None:
        sweep_spec(spec, ["seed=1"], tmp_path / "sweep", registry=registry, say=said.append)

    start()
    start()
    write_png(grey_png, np.full((40, 60, 1), 0.7, np.float32))
    start()
    heads = [text for text in said if "combinations" in text]
    assert heads == ["1 combinations, 1 to run", "1 combinations, 0 to run", "1 combinations, 1 to run"]


def test_a_combination_that_fails_stops_no_other_and_is_in_the_sheet(sweep: Sweeper, brittle: Registry) -> None:
    done = sweep("lens.facets=2,3,4", stages=brittle)
    assert done.failed
    assert run_folders(done) == {"facets=2", "facets=4"}
    rows = json.loads((done.folder / "sweep.json").read_text())["combinations"]
    assert [row["status"] for row in rows] == ["done", "failed", "done"]
    assert rows[1]["error"].endswith("failed: RuntimeError: three <b>is</b> too many")
    assert "integrator toy (magiclens-toys 1.2)" in rows[1]["error"]
    page = (done.folder / "sweep.html").read_text()
    assert "three &lt;b&gt;is&lt;/b&gt; too many" in page
    assert 'href="facets%3D4/report.html"' in page
    assert 'href="facets%3D3/report.html"' not in page


def test_a_failed_combination_is_tried_again(sweep: Sweeper, brittle: Registry) -> None:
    sweep("lens.facets=2,3", stages=brittle)
    assert not sweep("lens.facets=2,3").failed


def test_mistakes_that_a_check_finds_stop_a_sweep_before_it_begins(sweep: Sweeper, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--set lens.facets=0: lens.facets: must be at least 1, got 0"):
        sweep("lens.facets=2,0")
    assert not (tmp_path / "sweep").exists()


@pytest.mark.parametrize("strange", ["a run folder", "a file"])
def test_a_sweep_goes_into_no_strange_place(sweep: Sweeper, tmp_path: Path, strange: str) -> None:
    if strange == "a file":
        (tmp_path / "sweep").touch()
    else:
        sweep("seed=1", out=".")
        (tmp_path / "seed=1").rename(tmp_path / "sweep")
    with pytest.raises(InputError, match="is no folder of a sweep"):
        sweep("lens.facets=2,3")


FILLING = """
import os, sys
from pathlib import Path
from magiclens.running.replacing import atomic_folder
with atomic_folder(Path(sys.argv[1])):
    os.kill(os.getpid(), 9)
"""


class Interrupted(Serial):
    """Ends after its first item, as a user who has seen enough does; what a killed process leaves is there."""

    type = "interrupted"

    def map(self, function: Callable[[Any], Any], items: Any) -> Iterator[Any]:
        first, second = items
        yield function(first)
        subprocess.run([sys.executable, "-c", FILLING, second.out], check=False)
        assert list(Path(second.out).parent.glob(".mlens-*"))
        raise KeyboardInterrupt


def test_an_interrupted_sweep_keeps_what_is_finished_and_leaves_nothing_half_written(
    sweep: Sweeper, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        sweep("lens.facets=2,3", executor=Interrupted())
    assert os.listdir(tmp_path / "sweep") == ["facets=2"]
    said: list[str] = []
    sweep("lens.facets=2,3", say=said.append)
    assert said[0] == "2 combinations, 1 to run"


def test_the_table_has_keys_scores_and_metrics(sweep: Sweeper) -> None:
    done = sweep("lens.facets=2,3", "pipeline.matcher.window=10%")
    with (done.folder / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["lens.facets"] for row in rows] == ["2", "3"]
    assert {row["pipeline.matcher.window"] for row in rows} == {"10%"}
    manifest = json.loads((done.folder / rows[0]["folder"] / "manifest.json").read_text())
    assert float(rows[0]["psnr_db"]) == pytest.approx(np.mean([view["psnr_db"] for view in manifest["views"]]))
    assert float(rows[0]["step_max_mm"]) == manifest["metrics"]["step_max_mm"]
    assert float(rows[0]["seconds"]) == manifest["seconds"]


def test_without_renderers_there_are_no_scores_but_a_sheet(sweep: Sweeper) -> None:
    done = sweep("lens.facets=2,3", "pipeline.renderers=[]")
    rows = json.loads((done.folder / "sweep.json").read_text())["combinations"]
    assert [row["psnr_db"] for row in rows] == [None, None]
    assert (done.folder / "sweep.html").exists()


def test_other_renderers_are_scored_when_the_tracer_is_not_there(sweep: Sweeper) -> None:
    done = sweep("seed=1", "pipeline.renderers=[{type: toy}]")
    assert json.loads((done.folder / "sweep.json").read_text())["combinations"][0]["psnr_db"] > 10


@pytest.mark.tools
def test_the_contact_sheet_has_the_values_of_the_last_key_in_columns(sweep: Sweeper) -> None:
    with Image.open(sweep("lens.facets=2,3", "seed=1,2,3").folder / "sweep.png") as sheet:
        wide = sheet.size
    with Image.open(sweep("lens.facets=2,3", "seed=1,2,3,4", out="wider").folder / "sweep.png") as sheet:
        assert sheet.size[0] > wide[0]
        assert sheet.size[1] == wide[1]


def test_pictures_show_what_the_lens_shows(sweep: Sweeper) -> None:
    shown, nothing = combination_pictures(sweep("pipeline.renderers=[{type: tracer}],[]"))
    assert nothing.std() == 0
    first_view, no_view = shown[: COMBINATION_SIDE // 2, : COMBINATION_SIDE // 2], shown[COMBINATION_SIDE // 2 :]
    assert first_view.std() > 20
    assert no_view.std() == 0


def test_the_command_writes_the_sheet_and_says_how_it_went(
    mlens: Any, write_spec: SpecWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = mlens("sweep", write_spec(), "--set", "lens.facets=2,3")
    assert result.exit_code == 0, result.output
    assert "out/toy-sweep: sweep.html, sweep.png, sweep.csv, sweep.json" in result.stdout
    assert "2/2  facets=3: " in result.stderr
    assert (tmp_path / "out" / "toy-sweep" / "sweep.html").exists()


def test_json_alone_is_on_standard_output(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    result = mlens("sweep", write_spec(), "--set", "seed=1,2", "--out", tmp_path / "s", "--json")
    assert json.loads(result.stdout) == json.loads((tmp_path / "s" / "sweep.json").read_text())
    assert result.stderr == ""


def test_quiet_sweeps_say_nothing(mlens: Any, write_spec: SpecWriter, tmp_path: Path) -> None:
    result = mlens("sweep", write_spec(), "--set", "seed=1,2", "--out", tmp_path / "s", "--quiet")
    assert (result.exit_code, result.output) == (0, "")


def test_a_sweep_with_failures_ends_with_1(
    brittle: Registry, write_spec: SpecWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Registry, "load", lambda: brittle)
    command = ["sweep", str(write_spec()), "--set", "lens.facets=2,3", "--out", str(tmp_path / "s")]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 1
    assert "too many" in result.stdout


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--executor", "dusk"], "--executor: unknown executor 'dusk'"),
        (["--set", "lens.facest=2,3"], "--set lens.facest=2: lens.facest: unknown key; did you mean 'facets'?"),
    ],
)
def test_wrong_input_ends_with_2(mlens: Any, write_spec: SpecWriter, more: list[str], message: str) -> None:
    result = mlens("sweep", write_spec(), "--set", "seed=1,2", *more)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stdout == ""


SPEC = """\
scenario: {type: single, source: {type: circles, seed: 7, size: 10mm}, target: {art: heart}}
lens: {size: 10mm, facets: 2, microfacets: 4, thickness: 15mm}
pipeline:
  matcher: {type: exhaustive, window: 10%, scales: [0.3], candidates: 4}
  renderers: [{type: tracer, resolution: 48}]
report: {analyses: []}
"""


@pytest.mark.tools
def test_processes_make_the_same_bytes_as_serial(tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(SPEC, encoding="utf-8")
    settings = ["lens.facets=2,3", "seed=0"]
    serial = sweep_spec(tmp_path / "tiny.yaml", settings, tmp_path / "serial", Serial())
    spread = sweep_spec(tmp_path / "tiny.yaml", settings, tmp_path / "spread", Processes(workers=2))
    assert not serial.failed, serial.results
    for one, other in zip(serial.results, spread.results, strict=True):
        assert no_timings(dict(one.manifest or {})) == no_timings(dict(other.manifest or {}))
