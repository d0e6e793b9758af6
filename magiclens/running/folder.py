"""Run folders and the files in them: written whole or not at all, and read back."""

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
"""File that describes a run; a folder is a run folder if and only if this file is in it."""
HEIGHTS = "heights.npz"
"""File with the heights of the finished lens's top, from which the lens is traced again without a new design."""
_TRANSPORTS = "transports"
"""Folder of traced matrices, for lenses with an encoder: one ``scipy.sparse.load_npz`` file per eye, named after the
eye's first view."""


@contextmanager
def atomic_folder(out: Path) -> Iterator[Path]:
    """Yield an empty folder to fill, which becomes ``out`` if the block succeeds and is deleted if it fails.

    An older run folder at ``out`` is replaced at the end of a block that succeeds, not before.

    Raises:
        InputError: ``out`` exists and is neither empty nor a run folder, or its parent cannot be written to.
    """
    out = out.absolute()
    _check_replaceable(out)
    partial = _new_hidden_folder(out)
    try:
        yield partial
        out.parent.mkdir(parents=True, exist_ok=True)
        _move_into_place(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a path to write a file to, which replaces ``path`` if the block succeeds and is deleted if it fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as scratch:
        partial = Path(scratch, path.name)
        yield partial
        os.replace(partial, path)


@contextmanager
def atomic_subfolder(path: Path) -> Iterator[Path]:
    """Yield an empty folder to fill, which replaces ``path`` if the block succeeds and is deleted if it fails.

    Unlike with ``atomic_folder``, whatever was at ``path`` is replaced: it is a folder in a run folder.
    """
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as scratch:
        partial = Path(scratch, path.name)
        partial.mkdir()
        yield partial
        _move_into_place(partial, path)


def save_heights(solid: Solid, lens: Lens, folder: Path) -> None:
    """Write the heights of a solid to the run folder, unless its finisher replaced the grid of its facets."""
    from magiclens.geometry.solid import heights_of

    heights = heights_of(solid, lens)
    if heights is not None:
        np.savez_compressed(folder / HEIGHTS, heights_mm=heights.astype(np.float32))


def load_heights(folder: Path) -> FloatArray:
    """Read the heights of the finished lens from a run folder.

    Returns:
        (N, N, m + 1, m + 1) float64, mm, see ``HeightField``.

    Raises:
        InputError: The folder has no heights, since the finisher's mesh has no grid.
    """
    path = folder / HEIGHTS
    if not path.is_file():
        raise InputError(f"there is no {HEIGHTS}: its finisher made a mesh that cannot be traced again", str(folder))
    with np.load(path) as stored:
        heights: FloatArray = stored["heights_mm"].astype(np.float64)
    return heights


def save_transport(transport: Transport, view: View, folder: Path) -> None:
    """Write the traced matrix of a view to the run folder, so that other pictures are encoded without tracing."""
    from scipy.sparse import save_npz

    path = folder / _TRANSPORTS / f"{view.name}.npz"
    path.parent.mkdir(exist_ok=True)
    save_npz(path, transport.matrix)


def load_transport(view: View, folder: Path) -> Transport | None:
    """Read the traced matrix of a view from a run folder; None if the folder has no matrix of this view."""
    path = folder / _TRANSPORTS / f"{view.name}.npz"
    if not path.is_file():
        return None
    from scipy.sparse import load_npz

    matrix = load_npz(path)
    side = math.isqrt(matrix.shape[0])  # pictures are square, so the number of rows gives their side
    return Transport(matrix, (side, side), (view.source.shape[0], view.source.shape[1]))


def _check_replaceable(out: Path) -> None:
    """Raise InputError unless there is nothing at ``out``, or an empty folder, or an older run."""
    if out.is_dir() and ((out / MANIFEST).is_file() or not any(out.iterdir())):
        return
    if out.exists():
        raise InputError(f"'{out}' is there already and is not a run folder; choose another --out", "--out")


def _new_hidden_folder(out: Path) -> Path:
    """Make a hidden folder in the nearest existing parent of ``out``: on the same disk, so that renaming is atomic."""
    above = next(p for p in out.parents if p.exists())
    try:
        partial = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=above))
    except OSError as error:
        raise InputError(f"cannot write in '{above}': {error.strerror}", "--out") from None
    partial.chmod(0o777 & ~_umask())  # mkdtemp makes folders that only their owner may read
    return partial


def _umask() -> int:
    mask = os.umask(0)  # the mask can be read only by setting it
    os.umask(mask)
    return mask


def _move_into_place(partial: Path, out: Path) -> None:
    """Rename the finished folder to ``out``, and delete an older folder that was there."""
    old = partial.with_name(f"{partial.name}-old")
    if out.exists():
        out.rename(old)
    partial.rename(out)
    shutil.rmtree(old, ignore_errors=True)
