"""Run folders appear whole or not at all."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray, Lens, Solid, Transport, View
from magiclens.contract.errors import InputError

MANIFEST = "manifest.json"
HEIGHTS = "heights.npz"
"""The top of the finished lens, from which it is traced again without designing it anew."""
TRANSPORTS = "transports"
"""Of lenses with an encoder: the matrix of each eye, under the name of its first view; ``scipy.sparse.load_npz``."""


@contextmanager
def appearing(out: Path) -> Iterator[Path]:
    """An empty folder to fill; it is renamed to ``out`` when the block ends well, and gone when it does not.

    A run folder that is at ``out`` already is replaced only then. Anything else there is an InputError.
    """
    out = out.absolute()
    _refuse_strangers(out)
    partial = _beside(out)
    try:
        yield partial
        out.parent.mkdir(parents=True, exist_ok=True)
        _swap(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@contextmanager
def appearing_file(path: Path) -> Iterator[Path]:
    """Where to write a file, which is put in the place of ``path`` when the block ends well, and gone otherwise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as scratch:
        partial = Path(scratch, path.name)
        yield partial
        os.replace(partial, path)


def save_heights(solid: Solid, lens: Lens, folder: Path) -> None:
    """Keep the heights of a solid that still has its facets' grid."""
    from magiclens.geometry.solid import heights_of

    heights = heights_of(solid, lens)
    if heights is not None:
        np.savez_compressed(folder / HEIGHTS, heights_mm=heights.astype(np.float32))


def load_heights(folder: Path) -> FloatArray:
    """(N, N, m + 1, m + 1) float64, mm. Raises InputError if the folder has none."""
    path = folder / HEIGHTS
    if not path.is_file():
        raise InputError(f"there is no {HEIGHTS}: its finisher made a mesh that cannot be traced again", str(folder))
    with np.load(path) as stored:
        heights: FloatArray = stored["heights_mm"].astype(np.float64)
    return heights


def save_transport(transport: Transport, view: View, folder: Path) -> None:
    """Keep what a view's eye sees of its source, so that other pictures are encoded without tracing."""
    from scipy.sparse import save_npz

    path = folder / TRANSPORTS / f"{view.name}.npz"
    path.parent.mkdir(exist_ok=True)
    save_npz(path, transport.matrix)


def load_transport(view: View, folder: Path) -> Transport | None:
    """None if the folder has none of this view."""
    path = folder / TRANSPORTS / f"{view.name}.npz"
    if not path.is_file():
        return None
    from scipy.sparse import load_npz

    matrix = load_npz(path)
    side = math.isqrt(matrix.shape[0])
    return Transport(matrix, (side, side), (view.source.shape[0], view.source.shape[1]))


def _refuse_strangers(out: Path) -> None:
    """Only an empty folder or an older run may be replaced."""
    if out.is_dir() and ((out / MANIFEST).is_file() or not any(out.iterdir())):
        return
    if out.exists():
        raise InputError(f"'{out}' is there already and is not a run folder; choose another --out", "--out")


def _beside(out: Path) -> Path:
    """A new hidden folder on the same disk, in the nearest folder above that exists."""
    above = next(p for p in out.parents if p.exists())
    try:
        partial = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=above))
    except OSError as error:
        raise InputError(f"cannot write in '{above}': {error.strerror}", "--out") from None
    partial.chmod(0o777 & ~_umask())
    return partial


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _swap(partial: Path, out: Path) -> None:
    """Put the finished folder in place of the old one, if there is one."""
    old = partial.with_name(f"{partial.name}-old")
    if out.exists():
        out.rename(old)
    partial.rename(out)
    shutil.rmtree(old, ignore_errors=True)
