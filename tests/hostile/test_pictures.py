"""Pictures that are too large, or hold other things than expected: refused in words, or read rightly."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from magiclens.contract.errors import InputError
from magiclens.images.colour import to_linear
from magiclens.images.files import MOST_PIXELS_VARIABLE, read_image
from magiclens.images.movies import read_frames

PEAK = """
import re, sys
from pathlib import Path
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image
from magiclens.images.resample import padded_to_square
try:
    padded_to_square(read_image(sys.argv[1]))
except InputError as error:
    print("refused:", error)
# not getrusage, which also counts the memory of the process that started this one
print(int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1]) // 1024)
"""


def png(path: Path, width: int, height: int, rows: int) -> Path:
    """A grey PNG that says it is so large, with the data of some rows of zeros."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(bytes(width + 1)) for _ in range(rows)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b""))
    return path


@pytest.mark.parametrize(
    ("width", "height", "rows", "message"),
    [
        (13_000, 13_000, 13_000, "13000 x 13000 pixels, a square of 169 million"),
        (10_000, 1, 1, "10000 x 1 pixels, a square of 100 million"),
        (1, 30_000, 30_000, "1 x 30000 pixels"),
        (2**31 - 1, 2**31 - 1, 0, "pixels|cannot be read"),
    ],
)
def test_a_picture_that_is_too_large_costs_no_memory(
    width: int, height: int, rows: int, message: str, tmp_path: Path
) -> None:
    path = png(tmp_path / "large.png", width, height, rows)
    command = [sys.executable, "-c", PEAK, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    said, megabytes = done.stdout.splitlines()
    assert any(part in said for part in message.split("|")), said
    assert int(megabytes) < 500


def test_the_limit_can_be_moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = png(tmp_path / "long.png", 8_000, 1, 1)
    with pytest.raises(InputError, match=MOST_PIXELS_VARIABLE):
        read_image(path)
    monkeypatch.setenv(MOST_PIXELS_VARIABLE, "64000000")
    assert read_image(path).shape == (1, 8_000, 1)


def tiff_of_32_bits(values: np.ndarray) -> bytes:
    """An uncompressed grey TIFF of unsigned numbers."""
    short, long, start = 3, 4, 8 + 2 + 9 * 12 + 4
    tags = [
        (256, short, values.shape[1]), (257, short, values.shape[0]), (258, short, 32), (259, short, 1),
        (262, short, 1), (273, long, start), (277, short, 1), (279, long, values.nbytes), (339, short, 1),
    ]  # fmt: skip
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + struct.pack("<I", 0) + values.tobytes()


GREYS = np.array([[0.0, 0.25, 0.5, 1.0]])


@pytest.mark.parametrize(
    "values",
    [
        (GREYS * 255).astype(np.uint8),
        (GREYS * 65535).astype(np.uint16),
        np.rint(GREYS * (2**32 - 1)).astype(np.uint32),
        GREYS.astype(np.float32),
    ],
    ids=["8 bits", "16 bits", "32 bits", "floats"],
)
def test_grey_of_any_depth_is_as_bright(values: np.ndarray, tmp_path: Path) -> None:
    if values.dtype == np.uint32:  # which Pillow does not write
        (tmp_path / "grey.tif").write_bytes(tiff_of_32_bits(values))
    else:
        Image.fromarray(values).save(tmp_path / "grey.tif")
    np.testing.assert_allclose(read_image(tmp_path / "grey.tif")[..., 0], to_linear(GREYS), atol=4e-3)


def floats_beyond(folder: Path) -> Path:
    Image.fromarray(np.array([[0.0, 255.0]], np.float32)).save(folder / "x.tif")
    return folder / "x.tif"


def no_numbers(folder: Path) -> Path:
    Image.fromarray(np.array([[0.0, np.nan]], np.float32)).save(folder / "x.tif")
    return folder / "x.tif"


def signed(folder: Path) -> Path:
    Image.fromarray(np.array([[-5, 5]], np.int32)).save(folder / "x.tif")
    return folder / "x.tif"


def pages(folder: Path) -> Path:
    page = Image.new("L", (4, 4))
    page.save(folder / "x.tif", save_all=True, append_images=[page, page])
    return folder / "x.tif"


def film(folder: Path) -> Path:
    Image.new("L", (4, 4)).save(folder / "x.gif", save_all=True, append_images=[Image.new("L", (4, 4), 255)])
    return folder / "x.gif"


def postscript(folder: Path) -> Path:
    (folder / "x.eps").write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n")
    return folder / "x.eps"


def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "x.png")
    return folder / "x.png"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (floats_beyond, "floats beyond 0 to 1"),
        (no_numbers, "floats beyond 0 to 1"),
        (signed, "numbers with a sign"),
        (pages, "holds 3 pictures"),
        (film, "holds 2 pictures"),
        (postscript, "is not an image file that can be read"),
        (pipe, "is not an ordinary file"),
        (lambda folder: Path("/dev/zero"), "is not an ordinary file"),
    ],
)
def test_what_cannot_be_read_rightly_is_refused_in_words(
    make: Callable[[Path], Path], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        read_image(make(tmp_path))


def test_frames_are_not_read_from_a_pipe(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not an ordinary file"):
        read_frames(pipe(tmp_path))
