"""New specs: what is found in pictures, what the spec says of it, and that it can be run."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lenses import SHIPPED, SPECS
from magiclens.cli import app
from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import art, to_display, to_linear, write_png
from magiclens.images.resample import cropped_to_square
from magiclens.images.tones import toned
from magiclens.new.assess import assess
from magiclens.new.layouts import LAYOUTS, ON_MACHINES, SPECIAL
from magiclens.new.write import Making, new_spec
from magiclens.plan.compile import Plan, load_plan
from magiclens.running.pipeline import run_plan
from magiclens.scenarios.pictures import Target
from magiclens.scenarios.universal_animation import Frames

Saver = Callable[..., Path]


@pytest.fixture
def save(tmp_path: Path) -> Saver:
    """Writes a picture file."""

    def write(picture: FloatArray, name: str = "picture.png") -> Path:
        write_png(tmp_path / name, np.asarray(picture, np.float32))
        return tmp_path / name

    return write


@pytest.fixture
def panda(save: Saver) -> Path:
    return save(art("panda", 300), "panda.png")


def negative(picture: FloatArray) -> FloatArray:
    return to_linear(1 - to_display(picture))


def photograph(rows: int = 200, columns: int = 300) -> FloatArray:
    """Many tones, from dark grey to light grey."""
    x, y = np.meshgrid(np.linspace(0, 9, columns), np.linspace(0, 6, rows))
    return to_linear(0.5 + 0.2 * np.sin(x) * np.cos(y) + 0.05 * np.sin(3 * x + y))[..., None]


def stripes(width: int) -> FloatArray:
    """Black lines of that many pixels of 400 on white, as far from each other."""
    across = np.arange(400) // width % 2
    return np.broadcast_to(across[None, :, None], (400, 400, 1)).astype(float)


def planned(out: Path) -> Plan:
    return load_plan(out)


def only_target(out: Path) -> Target:
    plan: Any = planned(out)
    found: Target = plan.scenario.target
    return found


def test_a_drawing_on_white_is_left_as_it_is(panda: Path, tmp_path: Path) -> None:
    new_spec("single", [panda], tmp_path / "my.yaml")
    target = only_target(tmp_path / "my.yaml")
    assert (target.fit, target.levels, target.invert) == (None, None, None)
    assert planned(tmp_path / "my.yaml").lens.facets == 32


def test_a_light_drawing_on_a_dark_ground_is_inverted_and_the_comment_says_why(save: Saver, tmp_path: Path) -> None:
    text = new_spec("single", [save(negative(art("bat", 300)))], tmp_path / "my.yaml")
    assert only_target(tmp_path / "my.yaml").invert
    assert "light on dark" in text


def test_a_dark_photograph_is_never_inverted(save: Saver) -> None:
    found = assess(save(to_linear(0.3 * to_display(photograph()))))
    assert found.photograph
    assert not found.invert


def test_a_photograph_is_cropped_and_stretched_and_gets_more_facets(save: Saver, tmp_path: Path) -> None:
    text = new_spec("single", [save(photograph(), "holiday.png")], tmp_path / "my.yaml")
    target = only_target(tmp_path / "my.yaml")
    assert target.fit == "crop"
    assert target.levels is not None
    low, high = target.levels
    assert 0.25 < low < 0.35 < 0.65 < high < 0.75
    assert planned(tmp_path / "my.yaml").lens.facets == 64
    assert "holiday.png would lose detail" in text


@pytest.mark.parametrize(("width", "fine"), [(40, False), (20, False), (8, True), (4, True)])
def test_fine_strokes_ask_for_more_facets(save: Saver, width: int, fine: bool) -> None:
    found = assess(save(stripes(width)))
    assert found.stroke == pytest.approx(4 / np.pi * width / 400, rel=0.15)
    assert found.fine == fine


def test_coloured_pictures_get_coloured_discs(save: Saver, tmp_path: Path) -> None:
    picture = np.ones((100, 100, 3))
    picture[20:80, 20:80] = (0.8, 0.05, 0.05)
    new_spec("single", [save(picture)], tmp_path / "my.yaml")
    plan: Any = planned(tmp_path / "my.yaml")
    inks = plan.scenario.source.colours
    assert "#ffffff" in inks
    assert any(bytes.fromhex(ink[1:])[0] > 2 * max(bytes.fromhex(ink[3:])) + 100 for ink in inks), "no red"
    assert not plan.scenario.source.grey


def test_several_pictures_in_one_source_get_a_wider_window(panda: Path, tmp_path: Path) -> None:
    windows = []
    for scenario, count in (("single", 1), ("rotating", 2)):
        out = tmp_path / f"{count}.yaml"
        new_spec(scenario, [panda] * count, out)
        windows.append(planned(out).matcher.stage.model_dump(mode="json")["window"])
    assert windows == ["10%", "20%"]


@pytest.mark.parametrize(
    ("name", "written"),
    [("a b.png", '"a b.png"'), ("été.png", '"été.png"'), ("1.png", '"1.png"'), ("x#y: {z}.png", '"x#y: {z}.png"')],
)
def test_names_of_files_can_be_anything(save: Saver, tmp_path: Path, name: str, written: str) -> None:
    text = new_spec("single", [save(art("heart", 100), name)], tmp_path / "my.yaml")
    assert f"image: {written}}}" in text
    assert only_target(tmp_path / "my.yaml").image == tmp_path / name


def test_paths_start_at_the_specs_folder(panda: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "specs").mkdir()
    monkeypatch.chdir(tmp_path)
    text = new_spec("single", [Path("panda.png")], Path("specs/my.yaml"))
    assert "image: ../panda.png" in text


def test_a_source_of_ones_own_lies_below(panda: Path, save: Saver, tmp_path: Path) -> None:
    dots = save(art("foliage", 100), "dots.png")
    new_spec("single", [panda], tmp_path / "my.yaml", dots)
    plan: Any = planned(tmp_path / "my.yaml")
    assert plan.scenario.source.path == dots


def test_questions_are_asked_in_their_order(panda: Path, tmp_path: Path) -> None:
    new_spec("question-answer", [panda, panda], tmp_path / "my.yaml", questions=['Who "is" it?', "And: this?"])
    plan: Any = planned(tmp_path / "my.yaml")
    assert [pair.question.text for pair in plan.scenario.pairs] == ['Who "is" it?', "And: this?"]


@pytest.mark.parametrize("scenario", LAYOUTS)
def test_every_scenario_gets_a_spec_with_comments(scenario: str, panda: Path, save: Saver, tmp_path: Path) -> None:
    pictures = [panda, save(negative(art("bat", 200)), "bat.png")][: LAYOUTS[scenario].most]
    text = new_spec(scenario, pictures, tmp_path / "my.yaml")
    result = CliRunner().invoke(app, ["check", str(tmp_path / "my.yaml")])
    assert result.exit_code == 0, result.output
    assert all(len(line) <= 120 for line in text.splitlines())
    assert sum(line.lstrip().startswith("#") for line in text.splitlines()) >= 5


@pytest.mark.parametrize("scenario", LAYOUTS)
@pytest.mark.parametrize(("machine", "files"), [("sla", ["3mf", "sheet"]), ("lcd-12k", ["3mf", "sl1", "sheet"])])
def test_a_machine_sets_material_facets_and_files(
    scenario: str, machine: str, files: list[str], panda: Path, tmp_path: Path
) -> None:
    new_spec(scenario, [panda] * LAYOUTS[scenario].least, tmp_path / "my.yaml", making=Making(machine, "60mm"))
    plan = planned(tmp_path / "my.yaml")
    assert plan.lens.size_mm == 60
    assert plan.lens.facets < 32
    assert plan.lens.cells == "vertical"
    assert plan.lens.ior != pytest.approx(1.49)  # a resin, not acrylic
    assert [step.stage.type for step in plan.exporters] == files
    assert plan.lens.mark == (machine == "sla")  # where layers are written, it would make each another one


@pytest.mark.parametrize(
    ("machine", "jig", "mark"),
    [(None, False, False), (None, True, True), ("lcd-12k", True, True), ("egx-600", True, False)],
)
def test_a_lens_for_a_jig_is_marked_unless_a_mill_makes_it(
    machine: str | None, jig: bool, mark: bool, panda: Path, tmp_path: Path
) -> None:
    new_spec("single", [panda], tmp_path / "my.yaml", making=Making(machine, "60mm", jig=jig))
    assert planned(tmp_path / "my.yaml").lens.mark == mark


@pytest.mark.parametrize("scenario", LAYOUTS)
def test_without_a_machine_the_file_for_slicers_comes_first(scenario: str, panda: Path, tmp_path: Path) -> None:
    new_spec(scenario, [panda] * LAYOUTS[scenario].least, tmp_path / "my.yaml")
    assert [step.stage.type for step in planned(tmp_path / "my.yaml").exporters] == ["3mf", "stl", "sheet"]


def test_every_shipped_spec_may_be_asked_for_by_its_name(panda: Path, tmp_path: Path) -> None:
    names = set(SHIPPED) - set(LAYOUTS)
    assert names == set(ON_MACHINES) | set(SPECIAL)
    for name, (scenario, machine) in ON_MACHINES.items():
        new_spec(name, [panda] * LAYOUTS[scenario].least, tmp_path / f"{name}.yaml")
        mine, shipped = planned(tmp_path / f"{name}.yaml"), planned(SPECS / f"{name}.yaml")
        assert mine.scenario.type == shipped.scenario.type == scenario
        assert [plan.fabrication and plan.fabrication.name for plan in (mine, shipped)] == [machine] * 2
    for name in SPECIAL:
        with pytest.raises(InputError, match=f"take the options of specs/{name}.yaml"):
            new_spec(name, [panda] * 2, tmp_path / "special.yaml")


@pytest.mark.every_third
@pytest.mark.parametrize("scenario", LAYOUTS)
@pytest.mark.parametrize("place", ["hand", "wall"])
def test_facets_are_wider_in_a_hand_and_on_a_wall(scenario: str, place: str, panda: Path, tmp_path: Path) -> None:
    pictures = [panda] * LAYOUTS[scenario].least
    for machine in (None, "sla"):
        plans = []
        for name in ("table", place):
            out = tmp_path / f"{name}-{machine}.yaml"
            text = new_spec(scenario, pictures, out, making=Making(machine, "60mm", name))
            plans.append(load_plan(out))
        assert plans[1].lens.facets == plans[0].lens.facets // 2
        assert f"wide facets for the {place}" in text
        assert plans[1].spec.viewer.distance == (1500.0 if place == "wall" else 400.0)


@pytest.mark.parametrize(
    ("making", "message"),
    [
        (Making("slaa", "60mm"), "--machine: unknown machine 'slaa'; did you mean 'sla'?"),
        (Making("fdm", "60mm"), "--machine: a printer that melts filament cannot make a lens"),
        (Making(None, "60"), "--size: "),
        (Making(place="walls"), "--for: unknown place 'walls'; did you mean 'wall'?"),
    ],
)
def test_machines_sizes_and_places_that_are_none_are_explained(
    making: Making, message: str, panda: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        new_spec("single", [panda], tmp_path / "my.yaml", making=making)
    assert not (tmp_path / "my.yaml").exists()


SMALL = ["lens.size=24mm", "lens.facets=6", "lens.microfacets=4", "lens.relief=9mm"]
LONG = {"stable-zone", "universal-animation", "question-answer"}
"""Scenarios whose lenses take long."""
LARGER = {
    "multi-view": ["scenario.source.size=32mm"],
    "stable-zone": ["scenario.source.size=26mm"],
    "question-answer": ["lens.size=100mm", "lens.facets=16", "lens.relief=5mm"],
}


@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param(name, marks=pytest.mark.sweep if name in LONG else [pytest.mark.tools] * (name != "single"))
        for name in LAYOUTS
    ],
)
def test_every_scenarios_spec_runs(scenario: str, panda: Path, tmp_path: Path) -> None:
    new_spec(scenario, [panda] * LAYOUTS[scenario].least, tmp_path / "my.yaml")
    done = run_plan(
        load_plan(tmp_path / "my.yaml", [*SMALL, *LARGER.get(scenario, []), "report.analyses=[]"]), tmp_path / "out"
    )
    assert {"lens.3mf", "lens.stl", "lens.pdf"} <= {path.name for path in done.folder.iterdir()}


def garbage(folder: Path) -> Path:
    (folder / "garbage.png").write_bytes(b"no picture at all")
    return folder / "garbage.png"


def grey(folder: Path) -> Path:
    write_png(folder / "grey.png", np.full((50, 50, 1), 0.5, np.float32))
    return folder / "grey.png"


def nowhere(folder: Path) -> Path:
    return folder / "nowhere.png"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (garbage, "is not an image file that can be read"),
        (grey, "it shows next to nothing: its tones differ by 0 %"),
        (nowhere, "there is no image file"),
        (lambda folder: folder, "is a folder, not an image file"),
    ],
)
def test_pictures_that_cannot_be_used_are_named_and_nothing_is_written(
    make: Callable[[Path], Path], message: str, tmp_path: Path
) -> None:
    picture = make(tmp_path)
    before = os.listdir(tmp_path)
    with pytest.raises(InputError, match=message):
        new_spec("single", [picture], tmp_path / "my.yaml")
    assert os.listdir(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["singel", "{panda}"], "SCENARIO: unknown scenario 'singel'; did you mean 'single'?"),
        (["single", "{panda}", "{panda}"], "PICTURES: single takes one picture, got 2"),
        (["rotating", *["{panda}"] * 5], "PICTURES: rotating takes 2 to 4 pictures, got 5"),
        (["multi-pair", "{panda}", "--source", "{panda}"], "--source: multi-pair makes its sources itself"),
        (["single", "{panda}", "--question", "Who?"], "--question: single asks nothing"),
        (["question-answer", "{panda}", "--question", "A", "--question", "B"], "--question: 2 questions for 1"),
        (["single", "{panda}", "--source", "nowhere.png"], "there is no image file 'nowhere.png'"),
    ],
)
def test_wrong_requests_end_with_2(arguments: list[str], message: str, panda: Path, tmp_path: Path) -> None:
    command = ["new", *(a.format(panda=panda) for a in arguments), "-o", str(tmp_path / "my.yaml")]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "my.yaml").exists()


def test_a_spec_that_is_there_is_not_written_over(panda: Path, tmp_path: Path) -> None:
    out = tmp_path / "my.yaml"
    out.write_text("mine")
    with pytest.raises(InputError, match="is there already"):
        new_spec("single", [panda], out)
    assert out.read_text() == "mine"


def test_the_folder_of_the_spec_must_be_there(panda: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--out: .* cannot be a file"):
        new_spec("single", [panda], tmp_path / "no" / "my.yaml")


def test_levels_become_black_and_white() -> None:
    shown = to_display(toned(to_linear(np.array([[[0.1], [0.3], [0.5], [0.9]]])), 0.3, 0.5, False))
    assert shown.ravel() == pytest.approx([0, 0, 1, 1], abs=1e-5)
    inverted = to_display(toned(to_linear(np.array([[[0.25]]])), 0.0, 1.0, True))
    assert inverted.item() == pytest.approx(0.75, abs=1e-5)


def test_the_middle_of_a_picture_is_square() -> None:
    picture = np.arange(12.0).reshape(2, 6, 1)
    assert cropped_to_square(picture)[..., 0].tolist() == [[2, 3], [8, 9]]


def test_padding_around_a_negative_is_white(save: Saver) -> None:
    path = save(np.zeros((20, 60, 1)))
    shown = Target(image=path, invert=True).raster({})
    assert shown.shape == (60, 60, 1)
    assert shown.min() == 1
    assert Target(image=path).raster({})[30].max() == 0


@pytest.mark.parametrize("levels", [["50%", "50%"], ["90%", "10%"], ["0%", "101%"], ["10%"]])
def test_levels_must_rise(panda: Path, tmp_path: Path, levels: list[str]) -> None:
    new_spec("single", [panda], tmp_path / "my.yaml")
    with pytest.raises(InputError, match=r"scenario\.target\.levels"):
        load_plan(tmp_path / "my.yaml", [f"scenario.target.levels=[{', '.join(levels)}]"])


def test_levels_and_negatives_work_for_art_and_frames_too() -> None:
    known = {"heart": lambda size: art("heart", size), "heart-0": lambda size: art("heart", size)}
    plain = Target(art="heart").raster(known).mean()
    negative = Target(art="heart", invert=True).raster(known).mean()
    frame = Frames.model_validate({"art": "heart", "invert": True}, context={"art": ["heart-0"]}).targets()[0]
    assert plain > 0.5 > negative
    assert frame.raster(known).mean() == negative
