"""Types of fields that are checked against the world around a spec: files beside it, and art of plugins."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, TypedDict, cast

from pydantic import (
    AfterValidator,
    BeforeValidator,
    PlainSerializer,
    SerializationInfo,
    ValidationInfo,
    WithJsonSchema,
)

from magiclens.config.document import missing_file
from magiclens.config.suggest import unknown
from magiclens.contract.errors import InputError


class Context(TypedDict, total=False):
    """What pydantic hands to the validators of this module.

    Attributes:
        folder: The folder that paths in the spec are relative to; the current one if it is missing.
        art: Names of pictures; not checked if it is missing.
        sandbox: Whether files outside the folder are mistakes; they are not if it is missing.
        files: Collects the files that are found, each with its path as it was written.
    """

    folder: Path
    art: Collection[str]
    sandbox: bool
    files: dict[Path, str]


class Inputs(dict[Path, str]):
    """The files that a spec names, each with its path in a run folder; filled while the spec is dumped."""

    def portable(self, path: Path) -> str:
        """A file's path in a run folder, ``inputs/<name>``; files of equal names get different ones."""
        if path not in self:
            taken = set(self.values())
            names = (f"inputs/{path.stem}{f'-{n}' if n else ''}{path.suffix}" for n in range(len(taken) + 1))
            self[path] = next(name for name in names if name not in taken)
        return self[path]


def _context(info: ValidationInfo) -> Context:
    return cast(Context, info.context or {})


def _find(value: object, info: ValidationInfo) -> Path:
    if not isinstance(value, str | Path):
        raise ValueError(f"expected the path of a file, got {value!r}")
    context = _context(info)
    folder = context.get("folder", Path())
    path = folder / value
    # before anything else: whether a file is there is nobody's business either
    if context.get("sandbox") and is_outside(path, folder):
        raise ValueError(
            f"'{value}' is outside of the spec's folder, which --sandbox forbids; put a copy into the folder"
        )
    if path.is_dir():
        raise ValueError(f"'{path}' is a folder; name a file in it")
    if not path.is_file():
        raise ValueError(missing_file(path))
    # absolute, since executors may work in another folder
    found = path.absolute()
    context.get("files", {}).setdefault(found, str(value))
    return found


def is_outside(path: Path, folder: Path) -> bool:
    """Whether a file is not in a folder, once all links are followed."""
    return not path.resolve().is_relative_to(folder.resolve())


def readable_picture(path: Path) -> Path:
    """The path of a picture that can be read and is not tiny. Raises ValueError for all others."""
    from magiclens.images.files import check_not_tiny, read_image

    # read in full: a picture that is broken is then a mistake of the spec, with its line, and no run begins
    try:
        check_not_tiny(read_image(path), path)
    except InputError as error:
        raise ValueError(error.message) from None
    return path


def _dump(path: Path, info: SerializationInfo) -> str:
    inputs = (info.context or {}).get("inputs")
    return inputs.portable(path) if isinstance(inputs, Inputs) else str(path)


def _known_art(name: str, info: ValidationInfo) -> str:
    names = _context(info).get("art")
    if names is not None and name not in names:
        raise ValueError(unknown("art", name, names))
    return name


_FILE: dict[str, Any] = {"type": "string", "minLength": 1}

InputFile = Annotated[
    Path, BeforeValidator(_find), PlainSerializer(_dump, return_type=str, when_used="json"), WithJsonSchema(_FILE)
]
"""A file that exists: in a spec, a path relative to its folder; inside, an absolute path."""

ImageFile = Annotated[InputFile, AfterValidator(readable_picture)]
"""A picture file that can be read."""

ART_FORMAT = "magic-lens-art"
"""The ``format`` that marks names of art in JSON Schemas; ``json_schema`` puts the list of names in its place."""

ArtName = Annotated[str, AfterValidator(_known_art), WithJsonSchema({"type": "string", "format": ART_FORMAT})]
"""The name of a built-in picture or of one that a plugin contributes."""
