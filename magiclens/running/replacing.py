"""Files and folders that appear whole or not at all, and what a killed process has left of them.

A folder is filled under a hidden name beside its place, and then takes its place. The hidden name tells which process
works in it. So what a killed process has left is found by the next run to the same place, and removed or put back.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from itertools import chain
from pathlib import Path

from magiclens.contract.errors import InputError

_MARK = ".mlens-"
"""How hidden names begin."""
_REPLACED = "old"
"""Name, inside a hidden folder, of the folder that was at the place before."""
_FILLED = "new"
"""Name, inside a hidden folder, of the folder that is being filled."""
_AT_CWD, _EXCHANGE = -100, 2
"""Linux's AT_FDCWD and RENAME_EXCHANGE, from ``linux/fcntl.h`` and ``linux/fs.h``."""
_CANNOT = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP)
"""Errors of a disk, such as one on NFS, that cannot do what it is asked for."""


@contextmanager
def atomic_folder(place: Path, said: Callable[[str], None] = lambda _: None) -> Iterator[Path]:
    """Yield an empty folder to fill, which takes its place if the block succeeds and is deleted if it fails.

    What was at the place is replaced at the end of a block that succeeds, not before, and not before all files are on
    the disk. What a killed process has left beside the place is removed, or put back if the place is empty.

    Args:
        place: Where the folder shall be; no link. Nothing, or a folder, is there.
        said: Is told in one line what was removed or put back.

    Raises:
        InputError: The folder above cannot be written to.
        OSError: A file could not be written; it is named as if it were in its place.
    """
    above = next(folder for folder in place.parents if folder.exists())
    clear_leftovers(place, said)
    hidden = _new_hidden_folder(above, place)
    filled = hidden / _FILLED
    try:
        with _naming(filled, place):
            filled.mkdir()
            yield filled
            place.parent.mkdir(parents=True, exist_ok=True)
            _write_out(filled)
            _take_place(filled, place, hidden / _REPLACED)
    finally:
        _remove_hidden(hidden, place)


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a path to write a file to, which replaces ``path`` if the block succeeds and is deleted if it fails.

    Otherwise like ``atomic_folder``.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    clear_leftovers(path)
    hidden = _new_hidden_folder(path.parent, path)
    partial = hidden / f"{_FILLED}{path.suffix}"  # writers choose a format by the ending
    try:
        with _naming(partial, path):
            yield partial
            _write_out(partial)
            os.replace(partial, path)
    finally:
        _remove_hidden(hidden, path)


def clear_leftovers(place: Path, said: Callable[[str], None] = lambda _: None) -> None:
    """Remove what killed processes have left beside a place; a folder that they were replacing is put back.

    Args:
        place: Where a folder or file is, or was to be.
        said: Is told in one line what was removed or put back.
    """
    above = next((folder for folder in place.parents if folder.exists()), None)
    for hidden in sorted(above.glob(f"{_MARK}{_digest(place)}-*")) if above else ():
        if not _is_alive(hidden.name):
            if _remove_hidden(hidden, place):
                said(f"'{place}' was about to be replaced when the program was killed: it is back")
            else:
                said(f"removed what a killed run to '{place}' has left")


def _remove_hidden(hidden: Path, place: Path) -> bool:
    """Remove a hidden folder; whether it had what was at the place, which is put back if the place is empty."""
    lost = not place.exists() and (hidden / _REPLACED).exists()
    if lost:
        (hidden / _REPLACED).rename(place)
    shutil.rmtree(hidden, ignore_errors=True)
    return lost


@contextmanager
def _naming(hidden: Path, place: Path) -> Iterator[None]:
    """Let errors of the system name the place, which people know, and not what is filled beside it."""
    try:
        yield
    except OSError as error:
        # the second of two names is where a copy or a renamed file was to go
        named = Path(os.fsdecode(error.filename2 or error.filename or hidden))
        error.filename = str(place / named.relative_to(hidden) if named.is_relative_to(hidden) else named)
        error.filename2 = None
        raise


def _write_out(path: Path) -> None:
    """Have a file or a folder of files written to the disk: a name may be there before the content otherwise."""
    for each in chain([path], path.rglob("*")):
        if each.is_file():
            handle = os.open(each, os.O_RDWR)
            try:
                os.fsync(handle)
            except OSError as error:
                error.filename = str(each)
                if error.errno not in _CANNOT:
                    raise
            finally:
                os.close(handle)


def _take_place(filled: Path, place: Path, replaced: Path) -> None:
    """Move a folder to its place; what is there goes to ``replaced``, or away at the same moment if the system can."""
    if not place.exists():
        filled.rename(place)
    elif not _exchange(filled, place):
        place.rename(replaced)
        filled.rename(place)


def _exchange(one: Path, other: Path) -> bool:
    """Let two paths of one disk change their names at one moment; False where the system or the disk cannot."""
    if sys.platform != "linux":
        return False
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):  # a C library from before 2018
        return False
    if rename(_AT_CWD, os.fsencode(one), _AT_CWD, os.fsencode(other), _EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _CANNOT:
        return False
    raise OSError(code, os.strerror(code), str(other))


def _new_hidden_folder(above: Path, place: Path) -> Path:
    """Make a hidden folder on the same disk as the place, so that renaming takes no copy."""
    name = f"{_MARK}{_digest(place)}-{_process(os.getpid())}-"
    try:
        return Path(tempfile.mkdtemp(prefix=name, dir=above))
    except OSError as error:
        raise InputError(f"cannot write in '{above}': {error.strerror}", "--out") from None


def _digest(text: object) -> str:
    """Eight letters for a path or a name: hidden names must not be longer than the system allows."""
    return sha256(os.fsencode(str(text))).hexdigest()[:8]


def _process(pid: int) -> str:
    """Which process: its machine, its number, and when it began, since numbers are used again."""
    return f"{_digest(socket.gethostname())}-{pid}-{_began(pid)}"


def _began(pid: int) -> str:
    """When a process began, in ticks since the machine did; 0 where that cannot be found out."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return "0"
    return stat.rpartition(")")[2].split()[19]  # field 22; the second one, in brackets, may hold spaces


def _is_alive(hidden: str) -> bool:
    """Whether the process that a hidden name tells of may still be working; of other machines nothing is known."""
    machine, pid, began = hidden.removeprefix(_MARK).split("-")[1:4]
    if machine != _digest(socket.gethostname()) or os.name != "posix":
        return True
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it is somebody else's
        return True
    return began == _began(int(pid))
