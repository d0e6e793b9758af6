"""The HTML of every kind of page in the gallery. Everything that users wrote is escaped."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import NamedTuple
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

import magiclens
from magiclens.drawing.chart import Chart, ChartAxis, Curve
from magiclens.drawing.scales import Pixels
from magiclens.pages.templating import colours, render_page
from magiclens.web.gallery.docs import DOCS_FOLDER, DocPage, Heading, inline_markup
from magiclens.web.gallery.drawings import refraction
from magiclens.web.gallery.gallery_list import GalleryEntry, GalleryList
from magiclens.web.gallery.highlight import highlighted
from magiclens.web.gallery.lens import LensPage
from magiclens.web.gallery.parts import ReferencePage

PAPER_PAGE, LOOK_PAGE = "paper.html", f"{DOCS_FOLDER}/reference/look.html"
"""Where the two pages are that no list names."""
_PAPER_ABOUT = "What the figures of the paper show, and what this program makes of the same task."
_LOOK_PARTS = (
    ("colours", "Colours"), ("type", "Type"), ("buttons", "Buttons and fields"), ("cards", "Cards and figures"),
    ("verdicts", "Verdicts"), ("tables", "Tables and code"), ("charts", "Charts and drawings"),
)  # fmt: skip


class _Headed(NamedTuple):
    """What the template of pages with a list of their parts asks for."""

    title: str
    headings: Sequence[Heading]


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

    def paper(self) -> str:
        """The page that compares lenses with the figures of the paper, in the order of the figures."""
        compared = sorted((page for page in self._lenses if page.entry.paper), key=lambda page: _figure_of(page.entry))
        return self._render("paper.html", PAPER_PAGE, "Beside the paper", compared=compared, about=_PAPER_ABOUT)

    def look(self) -> str:
        """The page that shows every component of the pages, in the light and the dark colours."""
        page = _Headed("Look of all pages", [Heading(*each) for each in _LOOK_PARTS])
        return self._render(
            "look.html",
            LOOK_PAGE,
            page.title,
            page=page,
            colours=colours(),
            chart=_example_chart(),
            drawing=Markup(refraction("A ray through a facet")),
        )

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


def _figure_of(entry: GalleryEntry) -> int:
    """The number of the first figure that an entry's label names; entries without one come last."""
    found = re.search(r"Figures? (\d+)", entry.label)
    return int(found[1]) if found else 10**6


def _example_chart() -> Pixels:
    """A chart as reports have them."""
    xs = np.linspace(0, 2, 41)
    curves = [Curve("one lens", 22 - 3 * xs**2, "#2b6cc4"), Curve("another", 19 - xs**2, "#e8590c")]
    return Chart(
        xs, curves, ChartAxis("shift, mm", 0, 2), ChartAxis("PSNR, dB", 8, 24), (0, 1, "within 3 dB"), [1.0]
    ).draw()


def _plain(text: str) -> str:
    """A text without its markup, for previews of links."""
    return " ".join(re.sub(r"[`*]|\[([^]]*)\]\([^)]*\)", r"\1", text).split())
