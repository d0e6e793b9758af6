"""Keeps results in a folder that several processes share.

An entry is one ``.npz`` file, named after the key of what its result was made of. It holds the arrays of the result
and, as JSON, everything else: what it was made of, and which files were written. The content of these files is kept
once for each hash, however many entries name it.

Nothing is locked. Files are written under another name and renamed, which is one moment on local disks and on NFS; two
processes that make the same result write the same. Whatever is read is checked against its hash. What is missing,
cannot be read or cannot be written is no error: the result is made again, or not kept.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from magiclens.cache.folder import FOLDER_VARIABLE, most_bytes, results_folder
from magiclens.cache.sources import unchanged
from magiclens.cache.values import array_digest, digest_of, packed, unpacked

_ENTRIES, _FILES = "entries-1", "files-1"
"""Sub-folders; the number grows when older entries cannot be read any more."""
_PARTLY = ".partly-"
"""How names of files begin that are being written."""
_ABANDONED_S = 86400
"""Seconds after which such a file is one that a killed process has left."""
_HEADER = "header"
"""Name of the array of an entry that holds its JSON."""
_BLOCK = 1 << 20


class Damaged(Exception):
    """A result that is not as it was written, or not there any more."""


@dataclass(frozen=True)
class Entry:
    """A result that is kept.

    Attributes:
        key: What it is found by.
        step: The step that made it.
        made_of: What it was made of: options, sources, inputs.
        seconds: How long that took.
        facts: What the step returned besides arrays.
        files: SHA-256 of each file that it wrote, by its path in a run folder.
        rng: The state of the random generator afterwards; None if none was used.
        value: The result without its arrays, see ``packed``.
        content: Digest of all of this and of the arrays.
    """

    key: str
    step: str
    made_of: dict[str, Any]
    seconds: float
    facts: Any
    files: dict[str, str]
    rng: dict[str, Any] | None
    value: Any
    content: str


def new_entry(
    step: str,
    made_of: dict[str, Any],
    seconds: float,
    facts: Any = None,
    files: Iterable[str] = (),
    rng: dict[str, Any] | None = None,
) -> Entry:
    """An entry to be kept; ``Cache.keep`` completes it."""
    return Entry(digest_of(made_of), step, made_of, round(seconds, 3), facts, dict.fromkeys(files, ""), rng, None, "")


@dataclass(frozen=True)
class KeptFile:
    """A file of the cache: its path, its size in bytes, and when it was used last, seconds since 1970."""

    path: Path
    size_bytes: int
    used: float


class Cache:
    """Results of earlier runs. See the module for what its folder holds.

    Attributes:
        folder: Where they are.
        limit_bytes: How much room they may take.
    """

    def __init__(self, folder: Path, limit_bytes: int, say: Callable[[str], None] = lambda _: None):
        """``say`` is told in one line what is damaged, and, once, that nothing can be written."""
        self.folder, self.limit_bytes = folder, limit_bytes
        self._say = say
        self._read_only = self._grown = False

    def find(self, key: str) -> Entry | None:
        """The entry of a key, without its arrays; None if there is none. It counts as used now."""
        path = self._entry_path(key)
        try:
            entry = _header(path)
        except OSError:
            return None
        except Exception:  # readers of damaged files raise anything
            self._drop(path, "a result")
            return None
        _use(path)
        return entry

    def value(self, entry: Entry, inputs: Mapping[int, Any] = MappingProxyType({})) -> Any:
        """The result of an entry.

        Args:
            entry: What ``find`` returned.
            inputs: What the result was made from, as far as arrays are ``borrowed`` from it, by its place.

        Raises:
            Damaged: It cannot be read, or is not as it was written. It is removed then, and said aloud.
        """
        return unpacked(entry.value, self._checked_arrays(entry), inputs)

    def has_files(self, entry: Entry) -> bool:
        """Whether all files of an entry are there; their content is not looked at."""
        return all(self._file_path(content).is_file() for content in entry.files.values())

    def restore(self, entry: Entry, folder: Path) -> bool:
        """Copy the files of an entry into a run folder; False, and none of them there, if one is missing or damaged."""
        if not self.has_files(entry):  # some have been removed to make room
            return False
        for done, (name, wanted) in enumerate(entry.files.items(), 1):
            kept, path = self._file_path(wanted), folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                found = _copy(kept, path)
            except OSError:  # another process has just made room, or the disk is full, which the step will say
                found = ""
            if found and found != wanted:
                self._drop(kept, f"{path.name} of {entry.step}")
            if found != wanted:
                _remove(folder, list(entry.files)[:done])
                return False
            _use(kept)
        return True

    def keep(self, entry: Entry, value: Any = None, inputs: Sequence[Any] = (), folder: Path | None = None) -> None:
        """Keep a result, unless sources have been edited since their hashes were taken: then its key may be wrong.

        Args:
            entry: All but ``value``, ``files`` and ``content``, which are found here; the paths in ``files`` count.
            value: The result, see ``packed``, which raises NotPlain for what cannot be kept.
            inputs: What it was made from; arrays of theirs are not kept twice.
            folder: The run folder that has the files.
        """
        document, arrays = packed(value, inputs)
        if not unchanged():
            return
        with self._writing():
            files = {name: self._keep_file(folder / name) for name in entry.files} if folder else {}
            plain = {**vars(entry), "value": document, "files": files, "content": ""}
            whole = Entry(**{**plain, "content": _content(Entry(**plain), arrays)})
            header = np.frombuffer(json.dumps(vars(whole)).encode(), np.uint8)
            with self._replacing(self._entry_path(entry.key)) as partly, partly.open("wb") as stream:
                everything: dict[str, Any] = {_HEADER: header, **arrays}
                np.savez(stream, **everything)

    def remove(self, key: str) -> None:
        """Remove an entry that nobody needs any more; no error if there is none, or if it cannot be removed."""
        with suppress(OSError):
            self._entry_path(key).unlink()

    def entries(self) -> Iterator[Entry]:
        """All entries that can be read, those used last first."""
        for kept in reversed(self._kept(_ENTRIES)):
            with suppress(Exception):
                yield _header(kept.path)

    def used(self, key: str) -> KeptFile | None:
        """The file of an entry; None if it has been removed since."""
        return _kept_file(self._entry_path(key))

    def files(self) -> list[KeptFile]:
        """All files of the cache, those unused for longest first."""
        return sorted([*self._kept(_ENTRIES), *self._kept(_FILES)], key=lambda kept: kept.used)

    def verify(self) -> list[str]:
        """Read everything; what is damaged is removed. Returns a line for each of those."""
        said: list[str] = []
        before, self._say = self._say, said.append
        try:
            for kept in self._kept(_ENTRIES):
                entry = self.find(kept.path.stem)
                if entry:
                    with suppress(Damaged):
                        self._checked_arrays(entry)
            for kept in self._kept(_FILES):
                with suppress(OSError):
                    if file_digest(kept.path) != kept.path.name:
                        self._drop(kept.path, "a file")
        finally:
            self._say = before
        return said

    def make_room(self, limit_bytes: int | None = None) -> list[KeptFile]:
        """Remove what was unused for longest until the rest takes no more room than is allowed; what was removed."""
        limit = self.limit_bytes if limit_bytes is None else limit_bytes
        with suppress(OSError):
            for path in self.folder.glob(f"*/{_PARTLY}*"):
                if time.time() - path.stat().st_mtime > _ABANDONED_S:
                    path.unlink(missing_ok=True)
        files, gone = self.files(), []
        total = sum(kept.size_bytes for kept in files)
        for kept in files:
            if total <= limit:
                break
            with suppress(OSError):
                kept.path.unlink()
                total -= kept.size_bytes
                gone.append(kept)
        return gone

    def tidy(self) -> None:
        """Make room if something has been kept."""
        if self._grown:
            self.make_room()

    def _checked_arrays(self, entry: Entry) -> dict[str, NDArray[Any]]:
        """The arrays of an entry. Raises Damaged as ``value``."""
        path = self._entry_path(entry.key)
        try:
            with np.load(path) as stored:
                arrays = {name: stored[name] for name in stored.files if name != _HEADER}
            if _content(entry, arrays) == entry.content:
                return arrays
        except OSError as error:
            raise Damaged(entry.step) from error
        except Exception:  # readers of damaged files raise anything
            pass
        self._drop(path, f"the result of {entry.step}")
        raise Damaged(entry.step)

    def _drop(self, path: Path, what: str) -> None:
        self._say(f"{what} in the cache is damaged and will be made again: {path.name[:12]}")
        with suppress(OSError):
            path.unlink()

    def _keep_file(self, path: Path) -> str:
        """Keep a copy of a file unless there is a sound one; its hash."""
        found = file_digest(path)
        kept = self._file_path(found)
        if kept.is_file() and file_digest(kept) == found:
            _use(kept)
        else:
            with self._replacing(kept) as partly:
                shutil.copyfile(path, partly)
        return found

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """What cannot be written is not kept; that is said once."""
        try:
            yield
            self._grown = True
        except OSError as error:
            if not self._read_only:
                self._read_only = True
                self._say(f"nothing is kept in the cache '{self.folder}': {error.strerror}; see {FOLDER_VARIABLE}")

    @contextmanager
    def _replacing(self, path: Path) -> Iterator[Path]:
        """A path to write to, which then gets its name at one moment."""
        path.parent.mkdir(parents=True, exist_ok=True)
        partly = path.parent / f"{_PARTLY}{uuid4().hex}"
        try:
            yield partly
            os.replace(partly, path)
        except BaseException:
            partly.unlink(missing_ok=True)
            raise

    def _kept(self, sub_folder: str) -> list[KeptFile]:
        """Files of a sub-folder, those unused for longest first."""
        try:
            paths = [p for p in (self.folder / sub_folder).iterdir() if not p.name.startswith(_PARTLY)]
        except OSError:
            return []
        return sorted(filter(None, map(_kept_file, paths)), key=lambda kept: (kept.used, kept.path.name))

    def _entry_path(self, key: str) -> Path:
        return self.folder / _ENTRIES / f"{key}.npz"

    def _file_path(self, content: str) -> Path:
        return self.folder / _FILES / content


def usual_cache(say: Callable[[str], None] = lambda _: None) -> Cache | None:
    """The cache that the environment asks for; None if nothing is to be kept."""
    limit = most_bytes()
    return Cache(results_folder(), limit, say) if limit else None


def _use(path: Path) -> None:
    """Let a file count as used now; a folder that is read-only does not tell."""
    with suppress(OSError):
        os.utime(path)


def _header(path: Path) -> Entry:
    """An entry without its arrays. Raises OSError if it cannot be read, anything else if it is damaged."""
    with np.load(path) as stored:
        return Entry(**json.loads(stored[_HEADER].tobytes()))


def _remove(folder: Path, names: Iterable[str]) -> None:
    """Remove files, and folders that are empty then."""
    for name in names:
        (folder / name).unlink(missing_ok=True)
        for above in list((folder / name).relative_to(folder).parents)[:-1]:
            with suppress(OSError):
                (folder / above).rmdir()


def _kept_file(path: Path) -> KeptFile | None:
    try:
        found = path.stat()
    except OSError:  # another process has just removed it
        return None
    return KeptFile(path, found.st_size, found.st_mtime)


def _content(entry: Entry, arrays: Mapping[str, NDArray[Any]]) -> str:
    """Digest of an entry and of its arrays."""
    return digest_of([{**vars(entry), "content": ""}, {name: array_digest(array) for name, array in arrays.items()}])


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _copy(source: Path, target: Path) -> str:
    """Copy a file; the hash of what was copied."""
    found = hashlib.sha256()
    with source.open("rb") as given, target.open("wb") as stream:
        while block := given.read(_BLOCK):
            found.update(block)
            stream.write(block)
    return found.hexdigest()
