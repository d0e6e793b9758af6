"""What pages with scripts share: data within a script, and a page that is written beside the files of a run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from magiclens.contract.errors import InputError
from magiclens.running.manifest import refresh_manifest
from magiclens.running.replacing import atomic_file


def json_for_script(value: Any) -> str:
    """JSON that may be written within ``<script>``: nothing in it can end the element or begin a comment."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e")


def write_beside(run_dir: Path, path: Path, page: Callable[[], str]) -> Path:
    """Write a page about a run, whole or not at all; the manifest lists it if it is in the run folder.

    Args:
        run_dir: The run folder.
        path: The file to write.
        page: Makes its text.

    Returns:
        The file that was written.

    Raises:
        InputError: ``path`` is a folder, or as ``page``.
    """
    if path.is_dir():
        raise InputError(f"'{path}' is a folder; name a file, such as {path / 'page.html'}", "--out")
    text = page()
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    if path.resolve().is_relative_to(run_dir.resolve()):
        refresh_manifest(run_dir, path.resolve().relative_to(run_dir.resolve()).as_posix())
    return path
