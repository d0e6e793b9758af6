"""The HTML of every kind of page in the gallery. Everything that users wrote is escaped."""

from __future__ import annotations

import os
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

    def index(self) -> str:
        """The front page, with a card for each lens."""
        hero = next((page for page in self._lenses if page.name == self._gallery.hero), None)
        return self._render("index.html", "index.html", self._gallery.title, hero=hero)

    def lens(self, page: LensPage) -> str:
        """The page of one lens."""
        k = self._lenses.index(page)
        around = self._lenses[k - 1] if k else None, self._lenses[k + 1] if k + 1 < len(self._lenses) else None
        path = f"lenses/{page.name}.html"
        return self._render("lens.html", path, page.entry.title, lens=page, around=around)

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

        return render_page(
            f"magiclens.web.gallery/{template}",
            path=path,
            title=title,
            gallery=self._gallery,
            menu=self._menu,
            lenses=self._lenses,
            version=magiclens.__version__,
            to=to,
            inline_markup=inline_markup,
            highlighted=highlighted,
            **more,
        )
