"""A finished universal lens shows other pictures, without being designed again."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lenses import COARSE, Lenses
from magiclens.cli import app
from magiclens.contract.errors import InputError
from magiclens.geometry.solid import solid_from_heights
from magiclens.images import resize, score
from magiclens.images.art import ART
from magiclens.images.files import read_image, write_png
from magiclens.images.movies import read_frames, write_gif
from magiclens.profiles.materials import materials
from magiclens.rendering.poses import Pose
from magiclens.rendering.tracer import Tracer
from magiclens.running.open_run import open_run
from magiclens.running.pipeline import Run


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lenses are traced as finely as when they were designed."""
    for constant, pixels in COARSE.items():
        monkeypatch.setattr(constant, pixels)


@pytest.fixture(scope="module")
def run(lenses: Lenses) -> Run:
    return lenses.shipped("universal-animation")


def invoke(*arguments: str | Path) -> str:
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    assert done.exit_code == 0, done.output
    return done.output


def test_a_run_keeps_what_the_reopened_lens_is_made_of(run: Run) -> None:
    again = open_run(run.folder).solid
    np.testing.assert_allclose(again.vertices, run.result.solid.vertices, atol=1e-6)
    np.testing.assert_array_equal(again.faces, run.result.solid.faces)


def test_frames_share_the_matrix_that_the_run_kept(run: Run, tmp_path: Path) -> None:
    lens = open_run(run.folder)
    assert [path.name for path in (run.folder / "transports").iterdir()] == ["frame-00.npz"]
    assert lens.transport("frame-01") is lens.transport()
    assert "solid" not in vars(lens)
    shutil.copytree(run.folder, tmp_path / "bare", ignore=shutil.ignore_patterns("transports"))
    traced, source = open_run(tmp_path / "bare"), run.result.scene.views[0].source
    assert traced.transport("frame-01") is traced.transport()
    np.testing.assert_allclose(traced.transport().see(source), lens.transport().see(source), atol=0.02)


def test_an_animation_comes_with_its_movies(run: Run) -> None:
    for name in ("sources.gif", "sources.mp4", "seen.gif", "seen.mp4"):
        assert len(list(read_frames(run.folder / "animations" / name))) == 2


def test_another_picture_is_encoded_and_decoded(run: Run, tmp_path: Path) -> None:
    target = ART["heart"](256)
    write_png(tmp_path / "heart.png", target)
    said = invoke("encode", run.folder, tmp_path / "heart.png", "-o", tmp_path / "source.png")
    assert re.search(r"without the lens the picture is guessable: 0\.\d\d of it shows", said)
    invoke("decode", run.folder, tmp_path / "source.png", "-o", tmp_path / "seen.png")
    source, seen = read_image(tmp_path / "source.png"), read_image(tmp_path / "seen.png")
    assert source.shape[:2] == run.result.scene.views[0].source.shape[:2]
    assert score(seen, target).psnr_db > 22
    assert score(seen, target).psnr_db > score(source, target).psnr_db + 10


def test_a_lens_is_seen_in_any_pose(run: Run) -> None:
    lens = open_run(run.folder)
    target = resize(run.result.scene.views[1].target, (128, 128))
    designed = score(lens.seen(name="frame-01", resolution=128), target).psnr_db
    assert designed == pytest.approx(run.manifest["views"][1]["psnr_db"], abs=1.5)
    far = score(lens.seen(Pose(shift_x_mm=5), "frame-01", 128), target).psnr_db
    near = score(lens.seen(Pose(shift_x_mm=0.1), "frame-01", 128), target).psnr_db
    assert designed > near > far + 3


@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_the_matrix_of_a_pose_gives_the_picture_of_that_pose(turn: float, run: Run) -> None:
    """Also of a lens that is turned on its sheet: the picture turns with it, the sheet does not."""
    first = open_run(run.folder)
    views = tuple(replace(view, rotation_deg=turn) for view in first.scene.views)
    lens = replace(first, scene=replace(first.scene, views=views))
    source, pose = lens.lit_scene.views[0].source, Pose(0.3, -0.1, 0.5, tilt_x_deg=0.4, eye_y_mm=4.0)
    np.testing.assert_allclose(lens.transport(pose=pose).see(source), lens.seen(pose), atol=2e-3)


def test_the_top_as_made_is_that_of_the_print(run: Run, lenses: Lenses) -> None:
    designed = open_run(run.folder)
    np.testing.assert_allclose(designed.top_as_made.heights_mm, run.result.height_field.heights_mm, atol=1e-6)
    printed = open_run(lenses.shipped("printed-single", "lens.size=12mm", "lens.facets=4").folder)
    view, top = printed.printed_scene.views[0], printed.top_as_made
    mesh, sampled = (
        score(Tracer(resolution=128).render(printed.printed_scene, solid)[0], view.target).psnr_db
        for solid in (printed.solid, solid_from_heights(top))
    )
    assert top.eye_mm is None
    assert sampled > mesh + 1


def test_movies_are_encoded_frame_by_frame(run: Run, tmp_path: Path) -> None:
    frames = [ART[name](128) for name in ("star", "moon", "key")]
    write_gif(tmp_path / "film.gif", frames, 10)
    invoke("encode", run.folder, tmp_path / "film.gif", "-o", tmp_path / "sources")
    invoke("decode", run.folder, tmp_path / "sources", "-o", tmp_path / "seen.mp4")
    for seen, target in zip(read_frames(tmp_path / "seen.mp4"), frames, strict=True):
        assert score(seen, target).psnr_db > 20


def test_colour_and_equal_bytes(run: Run, tmp_path: Path) -> None:
    target = np.zeros((64, 64, 3), np.float32)
    target[:, :32, 0], target[:, 32:, 2] = 0.8, 0.5
    write_png(tmp_path / "flag.png", target)
    for name in ("one.png", "two.png"):
        invoke("encode", run.folder, tmp_path / "flag.png", "-o", tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    lens = open_run(run.folder)
    (seen,) = lens.decode([read_image(tmp_path / "one.png")])
    assert score(seen, target).psnr_db > 22


def test_what_cannot_be_reopened_says_so(run: Run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a run folder"):
        open_run(tmp_path)
    with pytest.raises(InputError, match="unknown view 'frame-09'; did you mean 'frame-0"):
        open_run(run.folder).view("frame-09")


def test_sheets_are_painted_for_the_lens_as_another_machine_makes_it(run: Run, tmp_path: Path) -> None:
    """The print has other slopes and another index: a sheet that was painted for the design shows less."""
    designed = open_run(run.folder)
    printed = designed.made_by("sla")
    assert printed.scene.lens.ior == materials()["photopolymer-sla"].ior
    target = ART["heart"](64)
    shown = [
        score(next(printed.decode(lens.encode([target]))), target).psnr_db for lens in (designed, printed)
    ]  # fmt: skip
    assert shown[1] > shown[0] + 1


def test_no_sheet_is_painted_for_a_machine_that_there_is_not(run: Run, tmp_path: Path) -> None:
    write_png(tmp_path / "heart.png", ART["heart"](16))
    arguments = ["encode", run.folder, tmp_path / "heart.png", "-o", tmp_path / "sheet.png", "--machine", "slaa"]
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    assert done.exit_code == 2
    assert done.output == "error: --machine: unknown machine 'slaa'; did you mean 'sla'?\n"
    assert not (tmp_path / "sheet.png").exists()
