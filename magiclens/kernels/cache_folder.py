"""Where compiled kernels are kept."""

from __future__ import annotations

import os
from hashlib import sha256
from pathlib import Path

import platformdirs

PACKAGE = Path(__file__).resolve().parents[1]
"""The folder of magiclens."""
VARIABLE = "NUMBA_CACHE_DIR"
"""The variable of the environment that names another folder for compiled kernels."""


def caches_folder() -> Path:
    """The folder that holds a folder for each state of the sources."""
    chosen = os.environ.get(VARIABLE)
    return Path(chosen) if chosen else platformdirs.user_cache_path("magiclens")


def cache_folder(package: Path = PACKAGE) -> Path:
    """The folder for kernels that are compiled from a package's sources as they are.

    numba compiles a kernel again when its own file has changed. It would keep one that calls a kernel of another file,
    which has changed; and where a named tuple has another name, it cannot even read what it has kept. So every state of
    the files that kernels are made of has a folder of its own.
    """
    state = sha256()
    for path in sorted(package.rglob("*.py")):
        text = path.read_bytes()
        if any(word in text for word in (b"njit", b"NamedTuple", b"intrinsic")):
            state.update(path.relative_to(package).as_posix().encode() + b"\0" + text + b"\0")
    return caches_folder() / f"kernels-{state.hexdigest()[:16]}"
