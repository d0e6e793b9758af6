"""A copy of a site in a folder that web hosts serve as it is."""

from __future__ import annotations

import shutil
from pathlib import Path

from magiclens.cache.folder import size_text
from magiclens.contract.errors import InputError
from magiclens.running.replacing import atomic_folder

MOST_FILE_BYTES, _MOST_SITE_BYTES = 100_000_000, 1_000_000_000
"""What GitHub takes: the largest file, and the largest site."""
_AS_IT_IS = ".nojekyll"
"""Tells GitHub Pages to serve the files as they are."""


def check_place(place: Path) -> None:
    """Raise InputError if a folder cannot be replaced by a published site, since it holds something else."""
    free = not place.exists() or (place.is_dir() and not any(place.iterdir()))
    if not free and not (place / _AS_IT_IS).is_file():
        raise InputError(f"'{place}' is there already and is no published gallery; name a new folder", "--publish")
    if (place / ".git").exists():
        raise InputError(f"'{place}' is a repository, whose history would be lost; name a new folder", "--publish")


def publish_gallery(site: Path, place: Path) -> None:
    """Copy a finished site into a folder, whole or not at all.

    Args:
        site: The folder of the gallery.
        place: The folder to make; a gallery that was published there is replaced.

    Raises:
        InputError: The site, or a file of it, is larger than hosts take, or as ``check_place``.
    """
    check_place(place)
    sizes = {path: path.stat().st_size for path in site.rglob("*") if path.is_file() and not _is_hidden(path, site)}
    largest, total = max(sizes, key=lambda path: sizes[path]), sum(sizes.values())
    if sizes[largest] > MOST_FILE_BYTES:
        raise InputError(f"{largest} has {size_text(sizes[largest])}; hosts take {size_text(MOST_FILE_BYTES)} a file")
    if total > _MOST_SITE_BYTES:
        raise InputError(f"'{site}' has {size_text(total)}, hosts take {size_text(_MOST_SITE_BYTES)}; use --quick")
    with atomic_folder(place) as folder:
        shutil.copytree(site, folder, ignore=shutil.ignore_patterns(".*"), dirs_exist_ok=True)
        (folder / _AS_IT_IS).touch()


def _is_hidden(path: Path, site: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(site).parts)
