"""Small files that ask for all time or memory: ``mlens check`` refuses each soon, in one line that says where."""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from test_pictures import film, floats_beyond, no_numbers, pages, pipe, png, postscript, signed
from test_yaml import BOMBS

MOST_S, MOST_MB = 2.0, 500
"""Processor time beyond that of a sound spec, and memory in all."""
CHECK = """
import re, sys
from pathlib import Path
from magiclens.cli import app
try:
    app(["check", sys.argv[1]])
finally:
    # not getrusage, which also counts the memory of the process that started this one
    peak = re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1]
    print(f"{int(peak) // 1024} MB", file=sys.stderr)
"""
SPEC = "scenario:\n  type: single\n  source: {{type: circles}}\n  target: {{image: '{}'}}\n"
PICTURE_LINE = 4
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="64" height="64">{}</svg>'


def drawn(folder: Path, content: str) -> Path:
    (folder / "x.svg").write_text(SVG.format(content))
    return folder / "x.svg"


def uses_of_uses(folder: Path) -> Path:
    """A hundred thousand squares in a kilobyte."""
    groups = "".join(f'<g id="a{k}">' + f'<use href="#a{k - 1}"/>' * 10 + "</g>" for k in range(1, 6))
    return drawn(folder, f'<defs><g id="a0"><rect width="64" height="64"/></g>{groups}</defs><use href="#a5"/>')


def blurs(folder: Path) -> Path:
    rectangle = '<rect width="64" height="64" filter="url(#f)"/>'
    return drawn(folder, f'<filter id="f"><feGaussianBlur stdDeviation="1e9"/></filter>{rectangle * 2000}')


def deep_groups(folder: Path) -> Path:
    """The renderer runs out of stack."""
    return drawn(folder, "<g>" * 100_000 + "</g>" * 100_000)


def entities(folder: Path) -> Path:
    lines = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 10))
    path = drawn(folder, "<text>&a9;</text>")
    path.write_text(f'<!DOCTYPE svg [<!ENTITY a0 "xxxxxxxxxx">{lines}]>' + path.read_text())
    return path


def long_text(folder: Path) -> Path:
    """A PNG whose title has 200 MB."""
    body = zlib.compress(bytes(200_000_000), 9)
    kind, data = b"zTXt", b"Title\0\0" + body
    chunk = struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    whole = png(folder / "x.png", 64, 64, 64).read_bytes()
    (folder / "x.png").write_bytes(whole[:33] + chunk + whole[33:])  # after the signature and the header
    return folder / "x.png"


def many_pages(folder: Path) -> Path:
    """A TIFF of 50,000 pages, each of which Pillow compares with all before."""
    tags = [(256, 3, 64), (257, 3, 64), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1), (279, 4, 64)]
    page = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", tag, kind, 1, v) for tag, kind, v in tags)
    ends = range(8 + len(page) + 4, 8 + 50_000 * (len(page) + 4), len(page) + 4)
    (folder / "x.tif").write_bytes(b"II*\0\x08\0\0\0" + b"".join(page + struct.pack("<I", end) for end in ends))
    return folder / "x.tif"


def many_frames(folder: Path) -> Path:
    frame = b"\x21\xf9\x04\0\0\0\0\0\x2c\0\0\0\0\1\0\1\0\0\2\2\x44\1\0"
    (folder / "x.gif").write_bytes(b"GIF89a\x40\0\x40\0\x80\0\0\0\0\0\xff\xff\xff" + frame * 100_000 + b";")
    return folder / "x.gif"


def written(name: str, content: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return write


def large(width: int, height: int, rows: int) -> Callable[[Path], Path]:
    return lambda folder: png(folder / "x.png", width, height, rows)


PICTURES: dict[str, Callable[[Path], Path]] = {
    "square": large(13_000, 13_000, 13_000),
    "wide": large(10_000, 1, 1),
    "high": large(1, 30_000, 30_000),
    "of two billion rows": large(2**31 - 1, 2**31 - 1, 0),
    "a BMP that says it is huge": written(
        "x.bmp", b"BM" + struct.pack("<IHHIIiiHHIIiiII", 60, 0, 0, 54, 40, 2**31 - 1, 2**31 - 1, 1, 24, *[0] * 6)
    ),
    "a PPM that says it is huge": written("x.ppm", b"P6 1000000 1000000 255\n"),
    "a WebP that says it is huge": written(
        "x.webp", b"RIFF\x20\0\0\0WEBPVP8X\x0a" + bytes(7) + b"\xff\xff\xff\xff\xff\xff"
    ),
    "a GIF frame that is larger than its picture": written(
        "x.gif", b"GIF89a\x40\0\x40\0\x80\0\0\0\0\0\xff\xff\xff\x2c\0\0\0\0\xff\xff\xff\xff\0\2\2\x44\1\0;"
    ),
    "uses of uses": uses_of_uses, "blurs": blurs, "deep groups": deep_groups, "entities": entities,
    "long text": long_text, "many pages": many_pages, "many frames": many_frames, "pages": pages, "film": film,
    "floats beyond": floats_beyond, "no numbers": no_numbers, "signed": signed, "PostScript": postscript, "pipe": pipe,
    "endless": lambda folder: Path("/dev/zero"),
}  # fmt: skip


@cache
def usual_s(folder: Path) -> float:
    """Processor time for a sound spec."""
    (folder / "sound.yaml").write_text("scenario: {type: single, source: {type: circles}, target: {art: bat}}")
    code, seconds, *_ = checked(folder / "sound.yaml")
    assert code == 0
    return seconds


def checked(spec: Path) -> tuple[int, float, int, str]:
    """Of a check in a process of its own: its exit code, seconds of processor time, megabytes, and errors."""
    before = os.times()
    done = subprocess.run([sys.executable, "-c", CHECK, str(spec)], capture_output=True, text=True, timeout=300)
    after = os.times()
    seconds = after.children_user - before.children_user + after.children_system - before.children_system
    errors, _, peak = done.stderr.rstrip().rpartition("\n")
    return done.returncode, seconds, int(peak.removesuffix(" MB")), errors


def refused_at(line: int, spec: Path, shared: Path) -> None:
    code, seconds, megabytes, errors = checked(spec)
    assert code == 2, errors
    found = re.fullmatch(rf"error: {re.escape(str(spec))}:(\d+): [^\n]+", errors)
    assert found, errors
    assert line <= int(found[1]) <= max(line, 1.5 * line * (line > 1000))  # a list that is too long ends somewhere
    assert seconds - usual_s(shared) < MOST_S
    assert megabytes < MOST_MB


def test_there_are_forty_of_them() -> None:
    assert len(BOMBS) + len(PICTURES) > 40


@pytest.mark.tools
@pytest.mark.parametrize("kind", BOMBS)
def test_a_spec_that_asks_for_too_much_is_refused_at_its_line(
    kind: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text, line = BOMBS[kind]
    (tmp_path / "spec.yaml").write_text(text, encoding="utf-8")
    refused_at(line, tmp_path / "spec.yaml", tmp_path_factory.getbasetemp())


@pytest.mark.tools
@pytest.mark.parametrize("kind", PICTURES)
def test_a_picture_that_asks_for_too_much_is_refused_at_its_line(
    kind: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = PICTURES[kind](tmp_path)
    (tmp_path / "spec.yaml").write_text(SPEC.format(path))
    refused_at(PICTURE_LINE, tmp_path / "spec.yaml", tmp_path_factory.getbasetemp())
