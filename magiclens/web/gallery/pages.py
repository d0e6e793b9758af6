"""The HTML of every kind of page in the gallery. Everything that users wrote is escaped."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import NamedTuple
from urllib.parse import quote

import magiclens
from magiclens.pages.templating import render_page
from magiclens.web.gallery.docs import DOCS_FOLDER, DocPage, inline_markup
from magiclens.web.gallery.gallery_list import GalleryList
from magiclens.web.gallery.highlight import highlighted
from magiclens.web.gallery.lens import LensPage
from magiclens.web.gallery.parts import ReferencePage


class Link(NamedTuple):
    """A page of the site and its title."""

    path: str
    title: str


class Site:
    """Renders the pages of a site."""

    def __init__(self, gallery: GalleryList, menu: Mapping[str, Sequence[Link]], lenses: Sequence[LensPage]):
        """Keep what all pages need.

        Args:
            gallery: The list.
            menu: Pages of the documentation by section.
            lenses: Pages of the lenses in the order of the list.
        """
        self._gallery, self._menu, self._lenses = gallery, menu, lenses
        self._hero = next((page for page in lenses if page.name == gallery.hero), None)

    def index(self) -> str:
        """The front page, with a card for each lens."""
        return self._render("index.html", "index.html", self._gallery.title, hero=self._hero)

    def lens(self, page: LensPage) -> str:
        """The page of one lens."""
        k = self._lenses.index(page)
        around = self._lenses[k - 1] if k else None, self._lenses[k + 1] if k + 1 < len(self._lenses) else None
        path = f"lenses/{page.name}.html"
        return self._render(
            "lens.html",
            path,
            page.entry.title,
            lens=page,
            around=around,
            about=_plain(page.entry.caption),
            preview=page.preview,
        )

    def doc(self, page: DocPage) -> str:
        """A page of documentation."""
        return self._render("doc.html", page.path, page.title, page=page)

    def reference(self, page: ReferencePage) -> str:
        """A page of the reference."""
        return self._render("reference.html", page.path, page.title, page=page)

    def contents(self) -> str:
        """The page with links to all documentation."""
        return self._render("contents.html", f"{DOCS_FOLDER}/index.html", "Documentation")

    def _render(self, template: str, path: str, title: str, **more: object) -> str:
        def to(target: str) -> str:
            """A path of the site, relative to this page."""
            return quote(os.path.relpath(target, PurePosixPath(path).parent))

        def whole(target: str) -> str:
            """The address of a path of the site; relative to this page if nobody has said where the site is."""
            address = self._gallery.address.rstrip("/")
            return f"{address}/{quote(target)}" if address else to(target)

        return render_page(
            f"magiclens.web.gallery/{template}",
            path=path,
            title=title,
            gallery=self._gallery,
            menu=self._menu,
            lenses=self._lenses,
            version=magiclens.__version__,
            to=to,
            whole=whole,
            **{"about": _plain(self._gallery.lead), "preview": self._hero and self._hero.preview, **more},
            inline_markup=inline_markup,
            highlighted=highlighted,
        )


def _plain(text: str) -> str:
    """A text without its markup, for previews of links."""
    return " ".join(re.sub(r"[`*]|\[([^]]*)\]\([^)]*\)", r"\1", text).split())
