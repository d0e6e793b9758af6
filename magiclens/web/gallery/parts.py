"""The parts of reference pages, before they are HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from magiclens.web.gallery.docs import Heading, anchor_of
from magiclens.web.gallery.pictures import Picture


@dataclass(frozen=True)
class Table:
    """Rows of cells; text between backticks is code. ``note`` is a text above the table; it may be empty."""

    shape: ClassVar[str] = "table"
    note: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True)
class Code:
    """A listing."""

    shape: ClassVar[str] = "code"
    text: str
    language: str


@dataclass(frozen=True)
class Text:
    """Paragraphs; text between backticks is code."""

    shape: ClassVar[str] = "text"
    text: str

    @property
    def paragraphs(self) -> list[str]:
        """The paragraphs of the text that are not empty."""
        return [paragraph for paragraph in self.text.split("\n\n") if paragraph.strip()]


@dataclass(frozen=True)
class Images:
    """Small pictures with captions."""

    shape: ClassVar[str] = "images"
    items: Sequence[tuple[str, Picture]]


Block = Table | Text | Code | Images


@dataclass(frozen=True)
class Part:
    """A heading, an introduction, and blocks."""

    title: str
    text: str
    blocks: Sequence[Block]

    @property
    def anchor(self) -> str:
        """The anchor that links to the part end with."""
        return anchor_of(self.title)

    @property
    def all_blocks(self) -> list[Block]:
        """The introduction, then the blocks."""
        return [Text(self.text), *self.blocks]


@dataclass(frozen=True)
class ReferencePage:
    """A page of parts; ``path`` is relative to the site's folder."""

    path: str
    title: str
    lead: str
    parts: Sequence[Part]

    @property
    def headings(self) -> list[Heading]:
        """The headings of its parts."""
        return [Heading(part.anchor, part.title) for part in self.parts]
