"""Pictures in, pictures out: what ``mlens encode`` and ``decode`` read and write."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image, write_png
from magiclens.images.movies import frame_rate, read_frames, write_gif
from magiclens.running.convert import convert_pictures

LEVELS = (0.0, 0.2, 1.0)


def darker(frames: Iterable[FloatArray]) -> Iterator[FloatArray]:
    return (frame * np.float32(0.5) for frame in frames)


def flat(level: float) -> FloatArray:
    return np.full((16, 16, 1), level, np.float32)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three pictures whose names sort naturally, not by letters."""
    (tmp_path / "in").mkdir()
    for name, level in zip(("2", "9", "10"), LEVELS, strict=True):
        write_png(tmp_path / "in" / f"f{name}.png", flat(level))
    return tmp_path / "in"


def test_one_picture_becomes_one_png(folder: Path, tmp_path: Path) -> None:
    out = convert_pictures(darker, folder / "f10.png", tmp_path / "new" / "out.png")
    assert read_image(out) == pytest.approx(0.5, abs=0.005)


@pytest.mark.parametrize("name", ["out.gif", "out.mp4", "out"])
def test_a_folder_becomes_a_movie_or_a_folder(folder: Path, tmp_path: Path, name: str) -> None:
    out = convert_pictures(darker, folder, tmp_path / name)
    seen = [float(frame.mean()) for frame in read_frames(out)]
    assert seen == pytest.approx([level / 2 for level in LEVELS], abs=0.01)


def test_a_movie_keeps_its_frame_rate(tmp_path: Path) -> None:
    write_gif(tmp_path / "in.gif", [flat(level) for level in LEVELS], 20)
    assert frame_rate(convert_pictures(darker, tmp_path / "in.gif", tmp_path / "out.mp4")) == pytest.approx(20)


@pytest.mark.parametrize(
    ("source", "out", "message"),
    [
        ("f2.png", "out.gif", "write a .png"),
        ("f2.png", "out", "write a .png"),
        (".", "out.png", "write a .gif, an .mp4 or a folder"),
        ("nothing.png", "out.png", "there is no picture"),
        (".", "../in", "is not empty"),
    ],
)
def test_results_that_do_not_fit_are_refused(folder: Path, source: str, out: str, message: str) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(InputError, match=message):
        convert_pictures(darker, folder / source, folder / out)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("name", ["out.gif", "out.mp4", "out"])
def test_failing_work_leaves_nothing_behind(folder: Path, tmp_path: Path, name: str) -> None:
    def fails(frames: Iterable[FloatArray]) -> Iterator[FloatArray]:
        yield next(iter(frames))
        raise InputError("too dark")

    with pytest.raises(InputError, match="too dark"):
        convert_pictures(fails, folder, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize("name", ["out.gif", "out"])
def test_what_killed_work_leaves_does_not_stop_the_next(folder: Path, tmp_path: Path, name: str) -> None:
    def killed(frames: Iterable[FloatArray]) -> Iterator[FloatArray]:
        yield next(iter(frames))
        os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if child == 0:
        convert_pictures(killed, folder, tmp_path / name)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert not (tmp_path / name).exists()
    convert_pictures(darker, folder, tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", name]
