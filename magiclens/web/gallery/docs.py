"""Documentation: Markdown files as pages of the site, with drawings, pictures of runs, and links that are checked."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import unquote

from markupsafe import Markup, escape

from magiclens.config.document import missing_file
from magiclens.config.suggest import unknown
from magiclens.contract.errors import InputError
from magiclens.web.gallery.drawings import DRAWINGS
from magiclens.web.gallery.highlight import highlighted
from magiclens.web.gallery.pictures import Album

if TYPE_CHECKING:
    from markdown_it import MarkdownIt
    from markdown_it.token import Token

DOCS_FOLDER = "docs"
"""Folder of the site for its documentation."""
_PICTURE_WIDTH = 1100
"""Greatest width of a picture in a document, pixels."""


@dataclass(frozen=True)
class Heading:
    """A heading and the anchor that links to it end with."""

    anchor: str
    text: str


@dataclass(frozen=True)
class DocPage:
    """A page of documentation. ``path`` is relative to the site's folder."""

    path: str
    title: str
    body: Markup
    headings: Sequence[Heading] = ()


@dataclass
class Library:
    """Everything that documents can refer to.

    ``pages`` are the paths in the site of Markdown files, ``runs`` the run folders by the name of their lens. ``files``
    collects the files that were copied into the site.
    """

    site: Path
    album: Album
    pages: Mapping[Path, str]
    runs: Mapping[str, Path]
    files: set[str] = field(default_factory=set)


def doc_paths(sources: Sequence[Path]) -> dict[Path, str]:
    """The paths in the site of Markdown files; folders stay as they are, below the folder that all files are in."""
    if not sources:
        return {}
    paths = [normal_path(source) for source in sources]
    above = Path(os.path.commonpath([path.parent for path in paths]))
    return {p: f"{DOCS_FOLDER}/{p.relative_to(above).with_suffix('.html').as_posix()}" for p in paths}


def doc_page(source: Path, library: Library) -> DocPage:
    """Render a Markdown file.

    Raises:
        InputError: The file refers to something that is not there; names file and line.
    """
    return _Renderer(normal_path(source), library).page()


def anchor_of(text: str) -> str:
    """The anchor of a heading, formed as on most hosts of Markdown files."""
    return re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", "-")


def inline_markup(text: str) -> Markup:
    """Escape a sentence of a docstring or a description, but for `code`, ``code`` and **strong** text."""
    rich = re.sub(r"(`{1,2})(.+?)\1", r"<code>\2</code>", str(escape(text)))
    return Markup(re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", rich))


def normal_path(path: Path) -> Path:
    """A path without ``..`` in it."""
    return Path(os.path.normpath(path))


class _Renderer:
    """Renders one Markdown file."""

    def __init__(self, source: Path, library: Library):
        self._source, self._library = source, library
        self._path = library.pages[source]
        self._headings: list[Heading] = []
        self._title = source.stem

    def page(self) -> DocPage:
        """Render the page; its title is the first heading."""
        markdown = _markdown()
        tokens = markdown.parse(self._source.read_text(encoding="utf-8"))
        self._change(tokens)
        body = markdown.renderer.render(tokens, markdown.options, {})
        return DocPage(self._path, self._title, Markup(body), self._headings)

    def _change(self, tokens: Sequence[Token]) -> None:
        """Give headings anchors, colour code, and resolve links and pictures."""
        for k, token in enumerate(tokens):
            line = token.map[0] + 1 if token.map else 1
            if token.type == "heading_open":
                self._head(token, tokens[k + 1].content)
            elif token.type == "fence":
                token.type, token.content = "html_block", _block(token)
            for child in token.children or ():
                if child.type == "link_open":
                    child.attrs["href"] = self._link(str(child.attrs["href"]), line)
                elif child.type == "image":
                    child.type, child.content = "html_inline", self._picture(child, line)

    def _head(self, token: Token, text: str) -> None:
        plain = text.replace("`", "")
        token.attrs["id"] = anchor_of(plain)
        if token.tag == "h1":
            self._title = plain
        elif token.tag == "h2":
            self._headings.append(Heading(anchor_of(plain), plain))

    def _link(self, target: str, line: int) -> str:
        """The address of a link in the site: a page, or a copy of the file."""
        if re.match(r"[a-z]+:|#|//", target):
            return target
        name, hash_, anchor = target.partition("#")
        found = normal_path(self._source.parent / unquote(name))
        page = self._library.pages.get(found)
        if page is None:
            page = self._copied(found, line)
        return f"{self._away(page)}{hash_}{anchor}"

    def _copied(self, found: Path, line: int) -> str:
        if not found.is_file():
            raise InputError(f"broken link: {missing_file(found)}", f"{self._source}:{line}")
        path = f"{DOCS_FOLDER}/files/{found.parent.name}-{found.name}"
        (self._library.site / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(found, self._library.site / path)
        self._library.files.add(path)
        return path

    def _picture(self, token: Token, line: int) -> str:
        """A picture file, whose title is the caption.

        The page can be read without the site, so the file is there. Instead of one in a folder ``drawings`` there is
        the drawing of this name, in the site's colours, and instead of one in ``runs/<lens>`` the file of this name
        that the gallery's own run of the lens has written.
        """
        caption = str(token.attrs.get("title", ""))
        found = normal_path(self._source.parent / unquote(str(token.attrs["src"])))
        if found.parent.name == "drawings":
            if found.stem not in DRAWINGS:
                raise InputError(unknown("drawing", found.stem, DRAWINGS), f"{self._source}:{line}")
            return _figure(DRAWINGS[found.stem](token.content), caption)
        group, found = self._of_run(found)
        if not found.is_file():
            raise InputError(f"broken picture: {missing_file(found)}", f"{self._source}:{line}")
        if found.suffix == ".svg":
            path = self._away(self._copied(found, line))
            return _figure(f'<img src="{escape(path)}" alt="{escape(token.content)}" loading="lazy">', caption)
        picture = self._library.album.shrunk(found, group, _PICTURE_WIDTH, token.content)
        size = f'width="{picture.width}" height="{picture.height}"'
        image = f'<img src="{escape(self._away(picture.path))}" {size} alt="{escape(token.content)}" loading="lazy">'
        return _figure(image, caption)

    def _of_run(self, found: Path) -> tuple[str, Path]:
        """The folder in which the site keeps a picture, and the picture: the file itself, or that of a run."""
        _, runs, path = found.as_posix().rpartition("/runs/")
        lens, _, name = path.partition("/")
        if not runs or lens not in self._library.runs:
            return DOCS_FOLDER, found
        return lens, self._library.runs[lens] / name

    def _away(self, path: str) -> str:
        """A path of the site, relative to this page."""
        return os.path.relpath(path, PurePosixPath(self._path).parent)


def _markdown() -> MarkdownIt:
    """CommonMark and tables; raw HTML is escaped."""
    from markdown_it import MarkdownIt

    return MarkdownIt("commonmark", {"html": False}).enable("table")


def _block(token: Token) -> str:
    language = token.info.split()[0] if token.info.strip() else ""
    return f'<pre tabindex="0"><code>{highlighted(token.content, language)}</code></pre>\n'


def _figure(inner: str, caption: str) -> str:
    """A picture with a caption; a span, since HTML allows no figure in a paragraph."""
    under = f'<span class="caption">{inline_markup(caption)}</span>' if caption else ""
    return f'<span class="figure">{inner}{under}</span>'


def first_line(text: str | None) -> str:
    """The first sentence or line of a docstring."""
    return (text or "").strip().split("\n\n")[0].replace("\n", " ")
