"""Field types that look things up while a spec is validated: files beside it and names that plugins contribute."""

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
    """What the validators of this module need to know; pydantic hands it to them."""

    folder: Path
    art: Collection[str]


class Inputs(dict[Path, str]):
    """Collects the files a spec uses while it is dumped, and gives each a path that a run folder can keep it under."""

    def portable(self, path: Path) -> str:
        """``inputs/<name>``, the same for the same file, different for files of equal names."""
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
    path = _context(info).get("folder", Path()) / value
    if path.is_dir():
        raise ValueError(f"'{path}' is a folder; name a file in it")
    if not path.is_file():
        raise ValueError(missing_file(path))
    return path.absolute()


def _picture(path: Path) -> Path:
    from magiclens.images.files import read_image

    try:
        read_image(path)
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
"""A file that exists; relative paths start at the spec's folder, an absolute path inside."""

ImageFile = Annotated[InputFile, AfterValidator(_picture)]
"""A picture file that can be read."""

ART_FORMAT = "magic-lens-art"
"""Marks names of art in a JSON Schema until it is known which there are."""

ArtName = Annotated[str, AfterValidator(_known_art), WithJsonSchema({"type": "string", "format": ART_FORMAT})]
"""The name of a built-in picture or of one that a plugin contributes."""
