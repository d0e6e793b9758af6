"""Pictures in, pictures out: one file, a folder, a GIF or a movie, whatever the names say."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from magiclens.contract.artifacts import FloatArray
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image, write_png

_FPS = 10.0
"""Of animations made from a folder of pictures."""

_MOVIES = (".gif", ".mp4")
Work = Callable[[Iterable[FloatArray]], Iterator[FloatArray]]


def convert(work: Work, source: Path, out: Path, px_per_mm: float | None = None) -> Path:
    """Read pictures, do the work on them and write the results to ``out``, which appears whole or not at all.

    One picture becomes one PNG. Several become a GIF, an MP4 or, if ``out`` has no ending, a folder of numbered PNGs.
    Raises InputError when ``out`` cannot hold what ``source`` is.
    """
    from magiclens.images.movies import frame_rate, is_still, read_frames, write_gif, write_mp4

    if not source.exists():
        raise InputError(f"there is no picture '{source}'")
    many = not is_still(source)
    ending = out.suffix.lower()
    if ending not in (("", *_MOVIES) if many else (".png",)):
        wanted = "a .gif, an .mp4 or a folder" if many else "a .png"
        raise InputError(f"'{out}' cannot hold this; write {wanted}", "--out")
    results = work(read_frames(source) if many else [read_image(source)])
    rate = frame_rate(source) if many else None
    with _appearing(out) as path:
        if not many:
            write_png(path, next(results), px_per_mm)
        elif ending == ".gif":
            write_gif(path, results, rate or _FPS)
        elif ending == ".mp4":
            write_mp4(path, results, rate or _FPS)
        else:
            path.mkdir()
            for k, picture in enumerate(results):
                write_png(path / f"frame-{k:04}.png", picture, px_per_mm)
    return out


@contextmanager
def _appearing(out: Path) -> Iterator[Path]:
    """A path beside ``out``, renamed to ``out`` at the end; an old file gives way, a folder with files does not."""
    if out.is_dir() and any(out.iterdir()):
        raise InputError(f"'{out}' is not empty; choose another folder", "--out")
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(f".{out.stem}-partial{out.suffix}")
    try:
        yield partial
        partial.replace(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        partial.unlink(missing_ok=True)
