"""Zip files that are equal when what is in them is."""

from __future__ import annotations

from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipInfo

_LEVEL = 4
"""Of zlib: rows of numbers get no smaller at 6, its default, and take twice as long."""


def entry(name: str, packed: bool = True) -> ZipInfo:
    """The entry of a file in an archive, without date or machine; ``packed`` is False if it is compressed already."""
    info = ZipInfo(name, (1980, 1, 1, 0, 0, 0))  # the earliest date that a zip file can hold
    info.create_system = 3  # Unix, wherever it is written
    info.external_attr = 0o644 << 16  # Unix permissions; those of zipfile let only the owner read
    info.compress_type = ZIP_DEFLATED if packed else ZIP_STORED
    # ``ZipFile`` has an option for this, but not for entries that are given to it
    info._compresslevel = _LEVEL  # type: ignore[attr-defined]
    return info
