"""numba's ``njit``, which keeps what it compiles in ``cache_folder``; all kernels import it from here."""

from __future__ import annotations

import os
import shutil
import time
from contextlib import suppress
from pathlib import Path

from numba import config, njit

from magiclens.kernels.cache_folder import cache_folder

__all__ = ["njit"]

_UNUSED_DAYS = 30
"""Kernels of other states of the sources are removed when nobody has used them for so long."""


def _prepare(folder: Path) -> None:
    """Make the folder, and remove those that have not been used for long."""
    if not folder.exists():
        folder.mkdir(parents=True, exist_ok=True)
        for other in folder.parent.glob("kernels-*"):
            if time.time() - other.stat().st_mtime > _UNUSED_DAYS * 86400:
                shutil.rmtree(other, ignore_errors=True)
    os.utime(folder)


with suppress(OSError):  # numba then looks for a place itself, or compiles for every run; see 'mlens doctor'
    _folder = cache_folder()
    _prepare(_folder)
    config.CACHE_DIR = str(_folder)  # type: ignore[attr-defined]
