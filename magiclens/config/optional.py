"""Packages that magiclens uses if they are there, and does without if they are not."""

from __future__ import annotations

from importlib.util import find_spec

PYMESHLAB = "pymeshlab"
"""The one package that a default install brings and that may be taken away: it is GPL-3, magiclens is MIT."""


def is_installed(package: str) -> bool:
    """Whether a package can be found; it is not imported, which may take long."""
    try:
        return find_spec(package) is not None
    except ImportError:  # an import hook that refuses it
        return False
