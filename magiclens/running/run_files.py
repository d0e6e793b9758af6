"""Reads run folders, and trusts nothing in them: files may have been damaged, edited or made up since the run."""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, Field, FiniteFloat, ValidationError

from magiclens.contract.artifacts import FloatArray, Lens, Transport, View
from magiclens.contract.errors import InputError
from magiclens.running.folder import FORMAT, HEIGHTS, MANIFEST, transport_path

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def _inside(path: str) -> str:
    parts = PurePosixPath(path).parts
    if not parts or path.startswith("/") or ".." in parts or "\\" in path or "\0" in path:
        raise ValueError("leaves the run folder")
    return path


_MOST_PACKED = 100
"""How many times as large as its file a matrix may be; real ones are twice as large."""

RelativePath = Annotated[str, AfterValidator(_inside)]
"""The path of a file in a run folder, with forward slashes."""


class ListedFile(BaseModel):
    """A file as the manifest lists it."""

    path: RelativePath
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    bytes: int = Field(ge=0)


class ListedView(BaseModel):
    """A view as the manifest lists it."""

    name: str
    eye_mm: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    rotation_deg: FiniteFloat
    source: RelativePath
    target: RelativePath
    renders: dict[str, RelativePath]
    psnr_db: FiniteFloat | None
    ssim: FiniteFloat | None


class ListedStage(BaseModel):
    """A stage as the manifest lists it."""

    kind: str
    type: str
    version: str
    plugin: str
    options: dict[str, Any]


class RunManifest(BaseModel):
    """What readers of a run folder rely on; see the page on run folders."""

    format: int
    name: str
    scenario: str
    scene: dict[str, FiniteFloat | str]
    views: list[ListedView] = Field(min_length=1)
    stages: list[ListedStage]
    metrics: dict[str, FiniteFloat | None]
    versions: dict[str, str]
    spec_sha256: str
    artifacts: list[ListedFile]


@dataclass(frozen=True)
class RunFiles:
    """A run folder whose manifest is right; see ``verified``.

    Attributes:
        path: The folder.
        manifest: As it was written.
    """

    path: Path
    manifest: dict[str, Any]

    @cached_property
    def listed(self) -> dict[str, dict[str, Any]]:
        """What the manifest says of its files, by path."""
        return {artifact["path"]: artifact for artifact in self.manifest["artifacts"]}

    def has(self, name: str) -> bool:
        """Whether the manifest lists such a file."""
        return name in self.listed

    def file(self, name: str) -> Path:
        """The path of a file that is as the run has written it.

        Raises:
            InputError: It is not listed, or missing, or has been changed.
        """
        if name not in self.listed:
            raise InputError(f"the run has no file '{name}'", str(self.path))
        path, wanted = self.path / name, self.listed[name]
        try:
            if not path.resolve().is_relative_to(self.path.resolve()) or not path.is_file():
                raise InputError(f"there is no {name}, although the run has written it", str(self.path))
            content = path.read_bytes() if path.stat().st_size == wanted["bytes"] else b""
        except OSError as error:
            raise InputError(f"the file cannot be read: {error.strerror}", str(path)) from None
        if len(content) != wanted["bytes"] or hashlib.sha256(content).hexdigest() != wanted["sha256"]:
            raise InputError("the file is not as the run has written it; run its spec again", str(path))
        return path

    def heights(self, lens: Lens) -> FloatArray:
        """The heights of the finished lens's top.

        Returns:
            (N, N, m + 1, m + 1) float64, mm, see ``HeightField``.

        Raises:
            InputError: The run has none, since its finisher's mesh has no grid; or they are none of this lens.
        """
        if not self.has(HEIGHTS):
            reason = "its finisher made a mesh that cannot be traced again"
            raise InputError(f"there is no {HEIGHTS}: {reason}", str(self.path))
        path, side = self.file(HEIGHTS), lens.microfacets + 1
        shape = (lens.facets, lens.facets, side, side)
        with _readable(path):
            _check_size(path, 4 * math.prod(shape))
            with np.load(path) as stored:
                heights: FloatArray = _floats(stored["heights_mm"]).astype(np.float64)
        if heights.shape != shape:
            raise InputError(f"it holds heights of shape {heights.shape} instead of {shape}", str(path))
        if not np.isfinite(heights).all() or np.abs(heights).max() > lens.thickness_mm:
            raise InputError("it holds heights that leave the slab", str(path))
        return heights

    def transport(self, view: View) -> Transport | None:
        """The traced matrix of a view; None if the folder has none.

        Raises:
            InputError: The file is no matrix from the view's source to a picture.
        """
        name = transport_path(view)
        if not self.has(name) or not (self.path / name).exists():  # it is large, and may have been deleted to save room
            return None
        path = self.file(name)
        rows, columns = view.source.shape[:2]
        with _readable(path):
            matrix = _matrix(path)
        side = math.isqrt(matrix.shape[0])  # pictures are square, so the number of rows gives their side
        if matrix.shape != (side * side, rows * columns):
            raise InputError(f"it holds a matrix of shape {matrix.shape}, which is none of this view", str(path))
        if not ((matrix.data >= 0) & (matrix.data <= 1)).all():  # NaN lies nowhere
            raise InputError("it holds shares of light that are none", str(path))
        return Transport(matrix, (side, side), (rows, columns))

    def check_files(self) -> None:
        """Check all listed files. Raises InputError as ``file``."""
        for name in self.listed:
            self.file(name)


def verified(folder: str | Path) -> RunFiles:
    """Open a run folder, and check its manifest; files are checked when they are asked for.

    Raises:
        InputError: It is no run folder, or its manifest is damaged or of a newer magiclens.
    """
    path = Path(folder)
    where = path / MANIFEST
    if not where.is_file():
        raise InputError(f"'{path}' is not a run folder: it has no {MANIFEST}")
    try:
        manifest = json.loads(where.read_bytes())
    except (ValueError, RecursionError):
        raise InputError("this is not JSON; run the spec again", str(where)) from None
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", str(where)) from None
    if isinstance(manifest, dict) and isinstance(manifest.get("format"), int) and manifest["format"] > FORMAT:
        raise InputError("this run is of a newer magiclens; upgrade", str(where))
    try:
        RunManifest.model_validate(manifest)
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{'.'.join(map(str, first['loc'])) or 'it'}: {first['msg']}", str(where)) from None
    return RunFiles(path, manifest)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn what numpy and scipy raise for damaged files into one error."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # readers of damaged files raise anything, one flipped bit is "encrypted" to them
        reason = (str(error) or repr(error)).splitlines()[0]
        raise InputError(f"the file is damaged: {reason}", str(path)) from None


def _matrix(path: Path) -> csr_array:
    """The sparse matrix of a file, of float32. Raises ValueError, or anything that readers raise, if it holds none."""
    from scipy.sparse import csr_array

    _check_size(path, _MOST_PACKED * path.stat().st_size)
    # not by scipy's reader: it takes numbers of any kind for indices, and says so aloud
    with np.load(path) as stored:
        if stored["format"].item() != b"csr":
            raise ValueError("its matrix has not one row after the other")
        pointers, indices, shape = (_integers(stored[name]) for name in ("indptr", "indices", "shape"))
        shares = _floats(stored["data"]).astype(np.float32, copy=False)
    matrix = csr_array((shares, indices, pointers), tuple(shape.tolist()))
    matrix.check_format(full_check=True)  # matrices are multiplied with indices that point anywhere
    return matrix


def _floats(array: NDArray[Any]) -> NDArray[Any]:
    """The array. Raises ValueError if it holds anything else than real numbers in binary floating point."""
    if array.dtype.kind != "f":
        raise ValueError(f"it holds {array.dtype} instead of floats")
    return array


def _integers(array: NDArray[Any]) -> NDArray[Any]:
    """The array. Raises ValueError if it holds anything else than signed integers."""
    if array.dtype.kind != "i":
        raise ValueError(f"it holds {array.dtype} instead of integers")
    return array


def _check_size(path: Path, most_bytes: int) -> None:
    """Raise ValueError if the arrays of a file are larger than they should be: a small file may hold a huge one."""
    with zipfile.ZipFile(path) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > most_bytes + 10_000:  # and headers
        raise ValueError(f"it holds {size} bytes, more than the {most_bytes} that it may")
