"""Movies in and out."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from skimage import data

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images import art, psnr_db, resize, to_display, to_linear, write_png
from magiclens.images.movies import frame_rate, read_frames, write_gif, write_mp4


def worm(side: int = 64) -> list[FloatArray]:
    """Eight grey frames."""
    return [art(f"worm-{k}", side) for k in range(8)]


def greys() -> list[FloatArray]:
    """Four frames (16, 16, 1) which together hold every grey."""
    values = np.arange(256, dtype=np.float32).reshape(16, 16, 1) / 255
    return [to_linear(np.roll(values, 5 * k, axis=0)) for k in range(4)]


def photographs() -> list[FloatArray]:
    """Four colour frames (128, 160, 3), a camera that pans."""
    picture = to_linear(data.astronaut().astype(np.float32) / 255)
    return [resize(picture[:320, 20 * k : 20 * k + 400], (128, 160)) for k in range(4)]


def levels(frame: FloatArray) -> FloatArray:
    return np.rint(to_display(frame) * 255)


def number(k: int) -> FloatArray:
    """A small plain frame of its own grey."""
    return np.full((4, 6, 1), k / 10, np.float32)


# Reading


def test_a_folders_images_come_in_natural_order_and_other_files_do_not_count(tmp_path: Path) -> None:
    for k in (10, 9, 1, 2):
        write_png(tmp_path / f"frame{k}.png", number(k))
    (tmp_path / "notes.txt").write_text("how it was made")
    (tmp_path / ".hidden.png").write_text("what some systems leave behind")
    found = [round(float(frame.mean()), 1) for frame in read_frames(tmp_path)]
    assert found == [0.1, 0.2, 0.9, 1.0]
    assert frame_rate(tmp_path) is None


def test_a_frame_is_read_only_when_it_is_asked_for(tmp_path: Path) -> None:
    write_png(tmp_path / "1.png", number(1))
    (tmp_path / "2.png").write_text("not an image")
    frames = read_frames(tmp_path)
    assert next(frames).shape == (4, 6, 1)
    with pytest.raises(InputError, match=r"2\.png"):
        next(frames)


def test_gif_frames_are_composited_over_those_before_them(tmp_path: Path) -> None:
    black, dot = Image.new("RGBA", (6, 6), (0, 0, 0, 255)), Image.new("RGBA", (6, 6), (0, 0, 0, 0))
    dot.putpixel((4, 1), (255, 0, 0, 255))
    black.save(tmp_path / "a.gif", save_all=True, append_images=[dot], duration=100, disposal=1)
    first, second = read_frames(tmp_path / "a.gif")
    assert first.shape == (6, 6, 1)
    assert not first.any()
    assert second[1, 4].tolist() == [1, 0, 0]
    assert second.sum() == 1


@pytest.mark.parametrize("suffix", ["png", "webp"])
def test_animated_png_and_webp_are_movies(tmp_path: Path, suffix: str) -> None:
    frames = [Image.new("RGB", (5, 3), colour) for colour in ((0, 0, 255), (255, 0, 0), (255, 255, 255))]
    path = tmp_path / f"a.{suffix}"
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=50, lossless=True)
    blue, red, white = read_frames(path)
    assert blue[0, 0].tolist() == [0, 0, 1]
    assert red[2, 4].tolist() == [1, 0, 0]
    assert white.shape == (3, 5, 1)
    assert frame_rate(path) == pytest.approx(20)


def test_half_transparent_frames_let_the_papers_light_through(tmp_path: Path) -> None:
    frames = [Image.new("RGBA", (5, 3), (0, 0, 0, alpha)) for alpha in (0, 128, 255)]
    frames[0].save(tmp_path / "a.png", save_all=True, append_images=frames[1:], duration=50, blend=0)
    assert [float(frame.mean()) for frame in read_frames(tmp_path / "a.png")] == pytest.approx([1, 1 - 128 / 255, 0])


@pytest.mark.parametrize(("suffix", "codec"), [("mp4", "libx264"), ("mov", "libx264"), ("webm", "libvpx-vp9")])
def test_video_files_are_read_frame_by_frame(tmp_path: Path, suffix: str, codec: str) -> None:
    path = tmp_path / f"a.{suffix}"
    filmed(path, codec)
    frames = list(read_frames(path))
    assert [frame.shape for frame in frames] == [(32, 48, 3)] * 3
    assert np.abs(levels(frames[2])[4, 4] - (255, 0, 0)).max() < 8
    assert np.abs(levels(frames[2])[-4, -4] - (0, 0, 0)).max() < 8
    assert frame_rate(path) == pytest.approx(10)


def test_a_film_taken_with_the_camera_on_its_side_is_turned_upright(tmp_path: Path) -> None:
    filmed(tmp_path / "a.mp4", "libx264", turned=90)
    frame = next(read_frames(tmp_path / "a.mp4"))
    assert frame.shape == (48, 32, 3)
    assert np.abs(levels(frame)[-4, 4] - (255, 0, 0)).max() < 8


def filmed(path: Path, codec: str, turned: int = 0) -> None:
    """Three frames 48 wide and 32 high, black with a red top left quarter; players turn it counter-clockwise."""
    picture = np.zeros((32, 48, 3), np.uint8)
    picture[:16, :24] = (255, 0, 0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, 10)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 48, 32, "yuv420p"
        if turned:
            stream.set_display_rotation(turned)
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24")))
        container.mux(stream.encode(None))


def empty(folder: Path) -> Path:
    (folder / "frames").mkdir()
    (folder / "frames" / "notes.txt").write_text("no images yet")
    return folder / "frames"


def still(folder: Path) -> Path:
    write_png(folder / "still.png", number(5))
    return folder / "still.png"


def text(folder: Path) -> Path:
    (folder / "notes.mp4").write_text("not a movie")
    return folder / "notes.mp4"


def listing(folder: Path) -> Path:
    """Some players show a text file as a film of a terminal."""
    (folder / "notes.txt").write_text("not a movie\n" * 50)
    return folder / "notes.txt"


def cut_video(folder: Path) -> Path:
    write_mp4(folder / "whole.mp4", photographs(), 10)
    (folder / "cut.mp4").write_bytes((folder / "whole.mp4").read_bytes()[:1500])
    return folder / "cut.mp4"


def cut_gif(folder: Path) -> Path:
    write_gif(folder / "whole.gif", photographs(), 10)
    (folder / "cut.gif").write_bytes((folder / "whole.gif").read_bytes()[:20_000])
    return folder / "cut.gif"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder / "none.mp4", "there is no movie file or folder"),
        (empty, "holds no images"),
        (still, "a single picture, not a movie"),
        (text, "is not a movie that can be read; use a folder"),
        (listing, "is not a movie that can be read"),
        (cut_video, "cannot be read"),
        (cut_gif, "cannot be read"),
    ],
)
def test_what_is_no_movie_is_named_in_one_sentence(tmp_path: Path, make: Callable[[Path], Path], words: str) -> None:
    path = make(tmp_path)
    with pytest.raises(InputError, match=words) as caught:
        list(read_frames(path))
    assert repr(str(path)) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("make", [lambda folder: folder / "none.mp4", empty, still, text])
def test_a_wrong_path_is_reported_before_the_first_frame_is_asked_for(
    tmp_path: Path, make: Callable[[Path], Path]
) -> None:
    with pytest.raises(InputError):
        read_frames(make(tmp_path))


# Writing GIFs


def test_a_grey_gif_keeps_every_level(tmp_path: Path) -> None:
    write_gif(tmp_path / "a.gif", greys(), 10)
    found = list(read_frames(tmp_path / "a.gif"))
    assert [frame.shape for frame in found] == [(16, 16, 1)] * 4
    for frame, wanted in zip(found, greys(), strict=True):
        assert np.array_equal(levels(frame), levels(wanted))


def test_a_gif_of_few_colours_keeps_them_exactly(tmp_path: Path) -> None:
    frames = [np.round(frame * 3) / 3 for frame in photographs()]
    write_gif(tmp_path / "a.gif", frames, 10)
    for frame, wanted in zip(read_frames(tmp_path / "a.gif"), frames, strict=True):
        assert np.array_equal(levels(frame), levels(wanted))


def test_a_colour_gif_looks_like_its_frames_and_has_one_palette(tmp_path: Path) -> None:
    write_gif(tmp_path / "a.gif", photographs(), 10)
    found = list(read_frames(tmp_path / "a.gif"))
    for frame, wanted in zip(found, photographs(), strict=True):
        assert psnr_db(to_display(frame), to_display(wanted)) > 34
    colours = np.unique(np.concatenate([levels(frame).reshape(-1, 3) for frame in found]), axis=0)
    assert 200 < len(colours) <= 256


def test_a_gif_loops_for_ever_and_keeps_its_tempo(tmp_path: Path) -> None:
    write_gif(tmp_path / "a.gif", worm(32) * 3, 24)
    with Image.open(tmp_path / "a.gif") as image:
        assert image.info["loop"] == 0
    assert frame_rate(tmp_path / "a.gif") == pytest.approx(24)
    assert len(list(read_frames(tmp_path / "a.gif"))) == 24


@pytest.mark.parametrize("fps", [0, -1, 51])
def test_a_gif_that_browsers_would_slow_down_is_refused(tmp_path: Path, fps: float) -> None:
    with pytest.raises(InputError, match="at most 50"):
        write_gif(tmp_path / "a.gif", worm(32), fps)
    assert not (tmp_path / "a.gif").exists()


# Writing MP4s


def test_an_mp4_looks_like_its_frames(tmp_path: Path) -> None:
    for name, frames, least_db in (("worm", worm(128), 40), ("photographs", photographs(), 32)):
        path = tmp_path / f"{name}.mp4"
        write_mp4(path, frames, 12.5)
        found = list(read_frames(path))
        for frame, wanted in zip(found, frames, strict=True):
            assert psnr_db(*np.broadcast_arrays(to_display(frame), to_display(wanted))) > least_db
        assert frame_rate(path) == pytest.approx(12.5)


def test_plain_colours_survive_mp4(tmp_path: Path) -> None:
    frames = [np.broadcast_to(np.float32(light), (32, 32, 3)) for light in ((1, 0, 0), (0.1, 0.6, 0.2), (0, 0.05, 0.9))]
    write_mp4(tmp_path / "a.mp4", frames, 10)
    for frame, wanted in zip(read_frames(tmp_path / "a.mp4"), frames, strict=True):
        assert np.abs(levels(frame) - levels(wanted)).max() <= 4


def test_an_mp4_plays_in_browsers_and_says_what_its_colours_mean(tmp_path: Path) -> None:
    write_mp4(tmp_path / "a.mp4", worm(64), 10)
    with av.open(str(tmp_path / "a.mp4")) as container:
        context = container.streams.video[0].codec_context
        assert (context.name, context.pix_fmt) == ("h264", "yuv420p")
        assert (context.colorspace, context.color_primaries, context.color_trc, context.color_range) == (1, 1, 13, 1)
    contents = (tmp_path / "a.mp4").read_bytes()
    assert contents.index(b"moov") < contents.index(b"mdat")


def test_odd_sides_grow_by_a_copy_of_the_last_row_and_column(tmp_path: Path) -> None:
    write_mp4(tmp_path / "a.mp4", [frame[:61, :33] for frame in worm(64)], 10)
    frame = next(read_frames(tmp_path / "a.mp4"))
    assert frame.shape[:2] == (62, 34)
    assert np.abs(levels(frame)[-1] - levels(frame)[-2]).mean() < 3


@pytest.mark.parametrize(("write", "suffix"), [(write_gif, "gif"), (write_mp4, "mp4")])
def test_equal_frames_give_equal_bytes_without_time_or_version(
    tmp_path: Path, write: Callable[..., None], suffix: str
) -> None:
    for name in "ab":
        write(tmp_path / f"{name}.{suffix}", photographs(), 10)
    contents = (tmp_path / f"a.{suffix}").read_bytes()
    assert contents == (tmp_path / f"b.{suffix}").read_bytes()
    for mark in (b"x264", b"Lavf", b"Lavc"):
        assert mark not in contents


@pytest.mark.parametrize("write", [write_gif, write_mp4])
def test_frames_of_two_sizes_or_none_are_refused(tmp_path: Path, write: Callable[..., None]) -> None:
    with pytest.raises(ValueError, match="one size"):
        write(tmp_path / "a", [worm(32)[0], worm(64)[1]], 10)
    with pytest.raises(ValueError, match="a movie needs"):
        write(tmp_path / "b", [], 10)


def test_importing_the_module_loads_no_decoder() -> None:
    code = "import sys, magiclens.images.movies; print(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"av", "PIL", "scipy"} & set(loaded)
