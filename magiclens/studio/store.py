"""The studio's folder: pictures that were uploaded and jobs; nothing outside of it is read or written."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from magiclens.cache.store import Cache
from magiclens.contract.errors import InputError
from magiclens.images.files import read_image, write_png

MOST_PICTURES = 200
"""How many pictures a studio keeps."""
MOST_JOBS = 200
"""How many jobs a studio keeps."""
_JOB = re.compile(r"[0-9]{4,8}-[0-9a-f]{8}")
_STATE = "job.json"


class StudioFolder:
    """Pictures and jobs on the disk, which is all that a studio knows after a restart.

    Attributes:
        root: The folder, made if it is not there.
        lock: Held while anything in the folder changes.
        version: Grows with every change, so that pages know when to look again.
        closing: Whether the server is about to end, so that streams of changes end.
    """

    def __init__(self, root: Path):
        self.root = root.absolute()
        self.lock = threading.RLock()
        self.version = 0
        self.closing = False
        self._decoding = threading.Lock()
        for name in ("pictures", "jobs", "cache"):
            (self.root / name).mkdir(parents=True, exist_ok=True)
        for left in self.root.glob(".new-*"):  # of a studio that was killed
            shutil.rmtree(left, ignore_errors=True)

    def touch(self) -> None:
        """Say that something has changed."""
        with self.lock:
            self.version += 1

    @contextmanager
    def filling(self) -> Iterator[Path]:
        """A hidden folder for things that are not whole yet; it is removed at the end."""
        folder = Path(tempfile.mkdtemp(prefix=".new-", dir=self.root))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def pictures(self) -> list[str]:
        """Names of the pictures, sorted."""
        return sorted(path.name for path in (self.root / "pictures").glob("*.png"))

    def add_picture(self, name: str, path: Path) -> str:
        """Read an uploaded file as specs read pictures, and keep it as a PNG.

        Args:
            name: What the user calls it.
            path: The file as it came.

        Returns:
            The name that it has in the studio.

        Raises:
            InputError: It is no picture that can be read, or there are too many.
        """
        with self._decoding:  # one at a time: a large picture takes some hundred megabytes
            decoded = path.with_name("decoded.png")
            try:
                write_png(decoded, read_image(path))
            except InputError as error:
                raise InputError(str(error).replace(str(path), name)) from None
        with self.lock:
            if len(self.pictures()) >= MOST_PICTURES:
                raise InputError(f"there are {MOST_PICTURES} pictures; delete some first")
            place = self._free(_plain(name), decoded.read_bytes())
            os.replace(decoded, place)
            self.touch()
        return place.name

    def delete_picture(self, name: str) -> bool:
        """Delete a picture; jobs keep their copies. False if there is none of this name."""
        with self.lock:
            found = file_below(self.root / "pictures", name)
            if found:
                found.unlink()
                self.touch()
        return found is not None

    def jobs(self) -> list[str]:
        """Identifiers of the jobs, the oldest first."""
        found = (path for path in (self.root / "jobs").iterdir() if _JOB.fullmatch(path.name) and _is_job(path))
        return sorted((path.name for path in found), key=_age)

    def job_folder(self, job: str) -> Path | None:
        """The folder of a job; None if there is none."""
        folder = self.root / "jobs" / job
        return folder if _JOB.fullmatch(job) and _is_job(folder) else None

    def add_job(self, fill: Callable[[Path], dict[str, Any]]) -> str:
        """Make a job whose folder appears whole.

        Args:
            fill: Writes spec and pictures into the folder that it is given, and returns what is to be known of the job.

        Raises:
            InputError: ``fill`` raises it, or there are too many jobs.
        """
        with self.filling() as parent:
            folder = parent / "job"
            folder.mkdir()
            state = fill(folder)
            with self.lock:
                jobs = self.jobs()
                if len(jobs) >= MOST_JOBS:
                    raise InputError(f"there are {MOST_JOBS} jobs; delete some first")
                job = f"{_age(jobs[-1])[0] + 1 if jobs else 1:04d}-{secrets.token_hex(4)}"
                (folder / _STATE).write_text(json.dumps(state), encoding="utf-8")
                folder.rename(self.root / "jobs" / job)
                self.touch()
        return job

    def state(self, job: str) -> dict[str, Any]:
        """What is known of a job that is there."""
        found: dict[str, Any] = json.loads((self.root / "jobs" / job / _STATE).read_text(encoding="utf-8"))
        return found

    def change(self, job: str, **values: Any) -> None:
        """Change what is known of a job, whole or not at all."""
        with self.lock:
            place = self.root / "jobs" / job / _STATE
            trial = place.with_name(".job.json")
            trial.write_text(json.dumps(self.state(job) | values), encoding="utf-8")
            os.replace(trial, place)
            self.touch()

    def delete_job(self, job: str) -> None:
        """Delete the folder of a job that is there and does not run."""
        with self.lock, self.filling() as bin_:
            (self.root / "jobs" / job).rename(bin_ / "job")
            self.touch()

    def used_bytes(self) -> int:
        """Room that the folder takes, kept results included."""
        return folder_bytes(self.root)

    def kept_bytes(self) -> int:
        """Room that kept results take."""
        return folder_bytes(self.root / "cache")

    def forget_results(self) -> None:
        """Delete kept results. A run that looks for one meanwhile makes it anew."""
        Cache(self.root / "cache", 0).make_room()
        self.touch()

    def _free(self, stem: str, content: bytes) -> Path:
        """A place for a picture: that of an equal one, or one that is not taken."""
        names = (f"{stem}{'' if k == 1 else f'-{k}'}.png" for k in range(1, MOST_PICTURES + 2))
        places = (self.root / "pictures" / name for name in names)
        return next(place for place in places if not place.exists() or place.read_bytes() == content)


@contextmanager
def sole_user(root: Path) -> Iterator[None]:
    """Make the folder of a studio, and be the only process that serves it.

    Raises:
        InputError: Another process serves it, or it cannot be made.
    """
    import fcntl

    try:
        root.mkdir(parents=True, exist_ok=True)
        lock = (root / ".lock").open("w")
    except OSError as error:
        raise InputError(f"'{root}' cannot be used: {error.strerror}", "--folder") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"another studio serves '{root}'; choose another folder", "--folder") from None
        yield


def folder_bytes(folder: Path) -> int:
    """Bytes of all files below a folder; links are not followed, and files may vanish meanwhile."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(os.path.join(parent, name)).st_size
            except OSError:
                continue
    return total


def file_below(folder: Path, relative: str) -> Path | None:
    """An ordinary file below a folder; None if there is none, or a link, a hidden name or ``..`` is on the way."""
    parts = relative.split("/")
    if "\\" in relative or any(not part or part.startswith(".") for part in parts):
        return None
    path = folder
    try:
        for part in parts:
            path = path / part
            if path.is_symlink():
                return None
        inside = path.resolve().is_relative_to(folder.resolve())
        return path if inside and path.is_file() else None
    except (OSError, ValueError):  # a name that is too long, or has a null character
        return None


def _is_job(folder: Path) -> bool:
    return not folder.is_symlink() and (folder / _STATE).is_file()


def _age(job: str) -> tuple[int, str]:
    number, rest = job.split("-")
    return int(number), rest


def _plain(name: str) -> str:
    """The stem of a file's name, of letters that are harmless in paths, YAML and pages."""
    stem = name.replace("\\", "/").rpartition("/")[2].rpartition(".")[0] or name
    kept = re.sub(r"[^a-z0-9]+", "-", stem.lower()[:60]).strip("-")
    return kept if kept[:1].isalpha() else f"picture-{kept}".rstrip("-")
