"""Where results are kept, and how much room they may take."""

from __future__ import annotations

import os
import re
from pathlib import Path

import platformdirs

from magiclens.contract.errors import InputError

FOLDER_VARIABLE = "MLENS_CACHE_DIR"
"""The variable of the environment that names another folder for results."""

SIZE_VARIABLE = "MLENS_CACHE_SIZE"
"""The variable of the environment that says how much room results may take, such as 20GB; with 0 nothing is kept."""

_USUAL_SIZE = "5GB"
_UNITS = {"B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}


def results_folder() -> Path:
    """The folder of all results of this user."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    return Path(chosen) if chosen else platformdirs.user_cache_path("magiclens") / "results"


def most_bytes() -> int:
    """How many bytes results may take; 0 if none are to be kept. Raises InputError if the variable is no size."""
    text = os.environ.get(SIZE_VARIABLE) or _USUAL_SIZE
    return size_in_bytes(text, SIZE_VARIABLE)


def keep_nothing() -> None:
    """Let this process, and those that it starts, neither keep results nor use those that are there."""
    os.environ[SIZE_VARIABLE] = "0"


def size_in_bytes(text: str, where: str) -> int:
    """Bytes of a size such as 500MB, or 0. Raises InputError, which names ``where``, if it is none."""
    if text.strip() == "0":
        return 0
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMGT]?B)\s*", text)
    if not found:
        raise InputError(f"'{text}' is no size; write one such as 500MB or 20GB", where)
    return int(float(found[1]) * _UNITS[found[2]])


def size_text(size_bytes: float) -> str:
    """A size for people: three digits, and the unit that suits it."""
    unit = next((unit for unit in ("TB", "GB", "MB", "kB") if size_bytes >= _UNITS[unit]), "B")
    return f"{size_bytes / _UNITS[unit]:.3g} {unit}"
