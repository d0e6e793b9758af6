"""Zip files that are equal when what is in them is."""

from __future__ import annotations

from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipInfo


def entry(name: str, packed: bool = True) -> ZipInfo:
    """The entry of a file in an archive, without date or machine; ``packed`` is False if it is compressed already."""
    info = ZipInfo(name, (1980, 1, 1, 0, 0, 0))  # the earliest date that a zip file can hold
    info.create_system = 3  # Unix, wherever it is written
    info.external_attr = 0o644 << 16  # Unix permissions; those of zipfile let only the owner read
    info.compress_type = ZIP_DEFLATED if packed else ZIP_STORED
    return info
