"""The interactive viewers of a gallery's lenses, kept between builds, since packing takes seconds for each."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path

from magiclens.contract.executors import Executor, raising
from magiclens.running.folder import HEIGHTS, MANIFEST
from magiclens.running.replacing import atomic_file
from magiclens.web.viewer import viewer_fragment

_CACHE = ".cache"
"""Folder of the site for files that only the next build needs."""


def viewer_fragments(runs: Mapping[str, Path], site: Path, executor: Executor) -> dict[str, str]:
    """Make the viewers of all lenses.

    Args:
        runs: Run folders by the name of their lens.
        site: The site's folder.
        executor: Where viewers are made.

    Returns:
        HTML sections by the name of the lens; empty if the mesh of a lens cannot be traced again.
    """
    kept = {name: site / _CACHE / f"{name}-{_key(folder)}.html" for name, folder in runs.items()}
    due = [(runs[name], path) for name, path in kept.items() if not path.is_file()]
    for _ in raising(executor.map(_write, due)):
        pass
    for path in (site / _CACHE).glob("*.html"):
        if path not in kept.values():
            path.unlink()
    return {name: path.read_text(encoding="utf-8") for name, path in kept.items()}


def _write(task: tuple[Path, Path]) -> None:
    folder, path = task
    text = viewer_fragment(folder) if (folder / HEIGHTS).is_file() else ""
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _key(folder: Path) -> str:
    """A hash that differs for different runs, and for another viewer."""
    return hashlib.sha256((folder / MANIFEST).read_bytes() + _code()).hexdigest()[:16]


@cache
def _code() -> bytes:
    """A hash of the viewer's files."""
    package = files("magiclens.web.viewer")
    found = [item for folder in (package, package / "templates") for item in folder.iterdir() if item.is_file()]
    return hashlib.sha256(b"".join(item.read_bytes() for item in sorted(found, key=lambda item: item.name))).digest()
