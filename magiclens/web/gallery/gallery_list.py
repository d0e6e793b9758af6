"""The gallery's list: which specs, in which order, under which captions, and which pages of documentation."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from pydantic import Field, field_validator

from magiclens.config.checker import Checker
from magiclens.config.document import missing_file, read_document
from magiclens.config.fields import InputFile
from magiclens.config.model import SpecModel
from magiclens.config.suggest import unknown
from magiclens.contract.errors import InputError

_NAME_PATTERN = r"^[a-z0-9][a-z0-9-]*$"
"""Names that can be part of a path and of an address."""


class GalleryEntry(SpecModel):
    """One lens of the list; paths are relative to the list's file."""

    name: str = Field(pattern=_NAME_PATTERN, description="names the page and the run folder")
    spec: InputFile = Field(description="the spec to run")
    title: str = Field(min_length=1, description="what one sees, in a few words")
    caption: str = Field(min_length=1, description="what it is about, in a few sentences")
    label: str = Field("", description="what stands above the title, such as the paper's figure that it reproduces")
    view: str | None = Field(None, min_length=1, description="the view that the card shows; the first if left out")
    paper: str = Field(
        "", description="what the paper's figure shows, for the page that compares; not there if left out"
    )
    quick: list[str] = Field([], description="key.path=value overrides of a quick build")

    def overrides(self, quick: bool) -> tuple[str, ...]:
        """The ``key.path=value`` overrides of a build; none unless it is quick."""
        return tuple(self.quick) if quick else ()

    def command(self, quick: bool) -> str:
        """The command that makes the lens again, in the folder in which the gallery was built."""
        here = Path(os.path.relpath(self.spec))
        spec = here if here.parts[0] != os.pardir else Path(self.spec.name)
        changes = [word for change in self.overrides(quick) for word in ("--set", change)]
        return shlex.join(["mlens", "run", spec.as_posix(), *changes])


class DocSection(SpecModel):
    """Pages of documentation under a common heading."""

    title: str = Field(min_length=1, description="the heading")
    pages: list[InputFile] = Field(min_length=1, description="Markdown files, in order")


class GalleryList(SpecModel):
    """The whole list."""

    title: str = Field("Magic lenses", min_length=1, description="the site's name")
    lead: str = Field("", description="what it is about, in a sentence")
    address: str = Field(
        "",
        pattern=r"^(https?://[\w.:/~-]+)?$",
        description="where the site is published, such as https://lenses.example.org; previews of links need it",
    )
    hero: str | None = Field(None, description="name of the entry at the top, of which all views can be looked at")
    entries: list[GalleryEntry] = Field(min_length=1, description="the lenses, in order")
    docs: list[DocSection] = Field([], description="the documentation, in order")

    @field_validator("entries")
    @classmethod
    def _names_are_different(cls, entries: list[GalleryEntry]) -> list[GalleryEntry]:
        names = [entry.name for entry in entries]
        twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
        if twice:
            raise ValueError(f"two entries are called {twice!r}; rename one of them")
        return entries


def load_gallery(path: str | Path) -> GalleryList:
    """Read the list of a gallery.

    Raises:
        InputError: The list is wrong; names file, line, key, the mistake and the nearest valid choice.
    """
    if not Path(path).is_file():
        hint = "name the list of a gallery, or call this in the folder that has it (the project's own repository)"
        raise InputError(f"{missing_file(Path(path))}; {hint}")
    document = read_document(path)
    checker = Checker(document, {"folder": document.folder})
    gallery = checker.validate(GalleryList, document.data)
    if gallery and gallery.hero not in (None, *(entry.name for entry in gallery.entries)):
        checker.add(("hero",), unknown("entry", gallery.hero, [entry.name for entry in gallery.entries]))
    return checker.settle(gallery)
