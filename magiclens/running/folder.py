"""Run folders: where they may be written, and what is kept in them to be read again."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from magiclens.contract.artifacts import Lens, Solid, Transport, View
from magiclens.contract.errors import InputError

MANIFEST = "manifest.json"
"""File that describes a run, see ``is_run_manifest``."""
FORMAT = 1
"""Version of the manifest's format; it grows when a key changes its meaning or goes."""
HEIGHTS = "heights.npz"
"""File with the heights of the finished lens's top, from which the lens is traced again without a new design."""
_TRANSPORTS = "transports"
"""Folder of traced matrices, for lenses with an encoder: one ``scipy.sparse.load_npz`` file per eye, named after the
eye's first view."""


OF_SYSTEMS = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
"""Files that operating systems leave in folders that somebody has looked at; nobody misses them."""


def place_for(out: Path) -> Path:
    """Where a run folder for ``out`` is written: the same path, without links.

    Raises:
        InputError: Something is there that must not be replaced: a file, a folder that no run has made, files in a run
            folder that the run has not made, the working folder, a link to nothing.
    """
    if out.is_symlink() and not out.exists():
        raise InputError(f"'{out}' is a link to nothing; choose another --out", "--out")
    place = out.resolve()
    if not place.exists():
        _check_writable(place)
        return place
    if not place.is_dir():
        raise InputError(f"'{out}' is there already and is not a run folder; choose another --out", "--out")
    if place == Path.cwd() or place in Path.cwd().parents or os.path.ismount(place):
        raise InputError(f"'{out}' is in use as a folder and cannot be replaced; choose another --out", "--out")
    strangers = _not_of_the_run(place)
    if strangers is None:
        raise InputError(f"'{out}' is there already and is not a run folder; choose another --out", "--out")
    if strangers:
        more = f" and {len(strangers) - 1} more" if len(strangers) > 1 else ""
        raise InputError(
            f"'{out}' is an older run, but '{strangers[0]}'{more} is not of it and would be lost; "
            "move it away or choose another --out",
            "--out",
        )
    _check_writable(place)
    return place


def require_same_name(out: Path, name: str) -> None:
    """Refuse to replace the run of another spec: a spec that is changed and run again keeps its name.

    Args:
        out: Where a run folder shall be written.
        name: The ``name`` of the spec that shall be run.

    Raises:
        InputError: A run whose spec has another name is there.
    """
    manifest = _run_manifest(out)
    if manifest and manifest.get("name") != name:
        raise InputError(
            f"'{out}' is the run of another spec, '{manifest.get('name')}'; choose another --out, "
            "or replace it with --force",
            "--out",
        )


def is_run_manifest(manifest: object) -> bool:
    """Whether JSON is the manifest of a run, and not that of something else: many programs call a file that."""
    return (
        isinstance(manifest, dict)
        and isinstance(manifest.get("format"), int)
        and isinstance(manifest.get("spec_sha256"), str)
        and isinstance(manifest.get("artifacts"), list)
        and all(isinstance(each, dict) and isinstance(each.get("path"), str) for each in manifest["artifacts"])
    )


def save_heights(solid: Solid, lens: Lens, folder: Path) -> None:
    """Write the heights of a solid to the run folder, unless its finisher replaced the grid of its facets."""
    from magiclens.geometry.solid import heights_of

    heights = heights_of(solid, lens)
    if heights is not None:
        # float32 is exact to a nanometre for heights of a few mm, and half as large
        np.savez_compressed(folder / HEIGHTS, heights_mm=heights.astype(np.float32))


def save_transport(transport: Transport, view: View, folder: Path) -> None:
    """Write the traced matrix of a view to the run folder, so that other pictures are encoded without tracing."""
    from scipy.sparse import save_npz

    path = folder / transport_path(view)
    path.parent.mkdir(exist_ok=True)
    save_npz(path, transport.matrix)


def transport_path(view: View) -> str:
    """Path of the traced matrix of a view in a run folder."""
    return f"{_TRANSPORTS}/{view.name}.npz"


def _run_manifest(folder: Path) -> dict[str, Any] | None:
    """The manifest of the run in a folder; None if there is no run."""
    try:
        manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_bytes())
    except (OSError, ValueError):
        return None
    return manifest if is_run_manifest(manifest) else None


def _not_of_the_run(folder: Path) -> list[str] | None:
    """What a run folder holds that its manifest does not list; None if it is none and not empty."""
    found = [path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir()]
    if not found:
        return []
    manifest = _run_manifest(folder)
    if manifest is None:
        return None
    listed = {MANIFEST, *(artifact["path"] for artifact in manifest["artifacts"])}
    names = [path.relative_to(folder).as_posix() for path in found if path.name not in OF_SYSTEMS]
    return [name for name in names if name not in listed or (folder / name).is_symlink()]


def _check_writable(place: Path) -> None:
    """Raise InputError unless the folder can be made: this is better known before a run than after it."""
    above = next(folder for folder in place.parents if folder.exists())
    if not above.is_dir():
        raise InputError(f"'{above}' is a file; choose another --out", "--out")
    if not os.access(above, os.W_OK | os.X_OK):
        raise InputError(f"cannot write in '{above}'; choose another --out", "--out")
