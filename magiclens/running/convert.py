"""Conversion of picture files: one picture, a folder, a GIF or a movie is read, changed, and written again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image, write_png
from magiclens.running.replacing import atomic_file, atomic_folder

_FPS = 10.0
"""Frames per second of animations that are made from a folder of pictures."""
_MOVIES = (".gif", ".mp4")

Conversion = Callable[[Iterable[FloatArray]], Iterator[FloatArray]]
"""A function from pictures (H, W, C), linear light, to as many pictures."""


def convert_pictures(conversion: Conversion, source: Path, out: Path, px_per_mm: float | None = None) -> Path:
    """Read pictures, convert them, and write the results, all of them or nothing.

    Args:
        conversion: What is done to the pictures.
        source: A picture file, a folder of pictures, or a movie.
        out: A PNG file for one picture. For several, a GIF or MP4 file or, without a suffix, a folder of numbered PNGs.
        px_per_mm: Resolution that PNG files state.

    Returns:
        ``out``.

    Raises:
        InputError: There is no ``source``, or ``out`` has the wrong suffix or is a folder that is not empty.
    """
    from magiclens.images.movies import frame_rate, is_still, read_frames, write_gif, write_mp4

    if not source.exists():
        raise InputError(f"there is no picture '{source}'")
    many = not is_still(source)
    suffix = out.suffix.lower()
    if suffix not in (("", *_MOVIES) if many else (".png",)):
        wanted = "a .gif, an .mp4 or a folder" if many else "a .png"
        raise InputError(f"'{out}' cannot hold this; write {wanted}", "--out")
    results = conversion(read_frames(source) if many else [read_image(source)])
    rate = frame_rate(source) if many else None
    if out.is_dir() and any(out.iterdir()):
        raise InputError(f"'{out}' is not empty; choose another folder", "--out")
    with atomic_file(out) if suffix else atomic_folder(out.resolve()) as path:
        if not many:
            write_png(path, next(results), px_per_mm)
        elif suffix == ".gif":
            write_gif(path, results, rate or _FPS)
        elif suffix == ".mp4":
            write_mp4(path, results, rate or _FPS)
        else:
            for k, picture in enumerate(results):
                write_png(path / f"frame-{k:04}.png", picture, px_per_mm)
    return out
