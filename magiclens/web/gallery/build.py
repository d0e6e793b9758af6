"""Builds the site: first the runs, then all pages."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import magiclens
from magiclens.contract.errors import InputError
from magiclens.contract.executors import Executor, Serial
from magiclens.pages.templating import template_text
from magiclens.plan.registry import Registry
from magiclens.running.jobs import RunJob
from magiclens.running.replacing import atomic_file
from magiclens.web.gallery.docs import DOCS_FOLDER, DocPage, Library, doc_page, doc_paths, normal_path
from magiclens.web.gallery.gallery_list import GalleryList
from magiclens.web.gallery.lens import LensPage, lens_page
from magiclens.web.gallery.pages import LOOK_PAGE, PAPER_PAGE, Link, Site
from magiclens.web.gallery.parts import ReferencePage
from magiclens.web.gallery.pictures import Album
from magiclens.web.gallery.reference import Commands, reference_pages
from magiclens.web.gallery.runs import refresh_runs
from magiclens.web.gallery.viewers import viewer_fragments

_LIST_FILE = "gallery.json"
"""The list for programs; a folder with this file is known to be a gallery."""
_RUNS = "runs"
"""The folder with a run folder for each lens."""
_OWN_FOLDERS = ("lenses", "pictures", DOCS_FOLDER)
"""Folders of the site from which files of older builds are removed."""
_ASSETS = {
    "tokens.css": "magiclens.pages", "shared.css": "magiclens.pages",
    "site.css": "magiclens.web.gallery", "site.js": "magiclens.web.gallery",
}  # fmt: skip
"""Packages of the files that are the same in every gallery."""


def build_gallery(
    gallery: GalleryList,
    out: Path,
    executor: Executor,
    registry: Registry,
    commands: Commands,
    quick: bool,
    say: Callable[[str], None],
) -> None:
    """Write the site of a list; equal lists and equal runs give equal pages.

    Args:
        gallery: The list; without entries, the documentation alone is written.
        out: The site's folder; runs in it that are still valid are not made again.
        executor: Where runs and viewers are made.
        registry: Installed stages.
        commands: The commands of the command line, for the reference.
        quick: Whether to make the smaller lenses of the list.
        say: Is given one line of text for each run, and at the end the path of the front page.

    Raises:
        InputError: A spec or a page of documentation is wrong, or the folder holds something else.
    """
    _claim(out)
    runs = {entry.name: out / _RUNS / entry.name for entry in gallery.entries}
    jobs = [
        RunJob(str(entry.spec), entry.overrides(quick), str(runs[entry.name].absolute())) for entry in gallery.entries
    ]
    if jobs:
        refresh_runs(jobs, executor, registry, say)
    album, shown = Album(out), viewer_fragments(runs, out, executor)
    lenses = [lens_page(entry, runs[entry.name], shown[entry.name], album, quick) for entry in gallery.entries]
    library = Library(out, album, doc_paths([page for section in gallery.docs for page in section.pages]), runs)
    docs = {source: doc_page(source, library) for source in library.pages}
    texts = _texts(gallery, lenses, docs, reference_pages(registry, commands, album))
    for name, text in {**texts, _LIST_FILE: _list_text(lenses, quick)}.items():
        _write(out / name, text)
    _tidy(out, {*texts, *library.files, *album.paths}, runs.values())
    say(f"{out / 'index.html'}")


def build_docs(
    gallery: GalleryList, out: Path, registry: Registry, commands: Commands, say: Callable[[str], None]
) -> None:
    """Write the documentation of a list alone, with the pictures that are in its folders; no lens is made.

    Arguments and errors are those of ``build_gallery``; ``out`` must not be a gallery with lenses.
    """
    if (out / _RUNS).is_dir():
        raise InputError(f"'{out}' is a gallery with lenses, which would be lost; choose another --out", "--out")
    bare = gallery.model_copy(update={"entries": [], "hero": None})
    build_gallery(bare, out, Serial(), registry, commands, False, say)


def _claim(out: Path) -> None:
    """Make the folder, or go on with the gallery in it; raise InputError if it holds something else."""
    known = (out / _LIST_FILE).is_file() or not out.exists() or (out.is_dir() and not any(out.iterdir()))
    if not known:
        raise InputError(f"'{out}' is there already and is no gallery; choose another --out", "--out")
    out.mkdir(parents=True, exist_ok=True)
    if not (out / _LIST_FILE).is_file():
        _write(out / _LIST_FILE, "{}\n")


def _texts(
    gallery: GalleryList, lenses: list[LensPage], docs: Mapping[Path, DocPage], generated: list[ReferencePage]
) -> dict[str, str]:
    """All text files of the site by path; the front page is last, so that it appears only when the site is whole."""
    menu = {section.title: [_link(docs[normal_path(source)]) for source in section.pages] for section in gallery.docs}
    menu["Reference"] = [*menu.get("Reference", []), *map(_link, generated), Link(LOOK_PAGE, "Look of all pages")]
    site = Site(gallery, menu, lenses)
    return {
        **{name: template_text(f"{package}/{name}") for name, package in _ASSETS.items()},
        **{page.path: site.doc(page) for page in docs.values()},
        **{page.path: site.reference(page) for page in generated},
        **{f"lenses/{page.name}.html": site.lens(page) for page in lenses},
        f"{DOCS_FOLDER}/index.html": site.contents(),
        LOOK_PAGE: site.look(),
        **({PAPER_PAGE: site.paper()} if any(page.entry.paper for page in lenses) else {}),
        "index.html": site.index(),
    }


def _link(page: DocPage | ReferencePage) -> Link:
    return Link(page.path, page.title)


def _list_text(lenses: Iterable[LensPage], quick: bool) -> str:
    """The text of ``gallery.json``."""
    rows = [
        {"name": page.name, "title": page.entry.title, "label": page.entry.label, "views": page.manifest["views"]}
        for page in lenses
    ]
    return json.dumps({"version": magiclens.__version__, "quick": quick, "lenses": rows}, indent=2) + "\n"


def _write(path: Path, text: str) -> None:
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _tidy(out: Path, kept: set[str], runs: Iterable[Path]) -> None:
    """Remove pages, pictures and runs that the list no longer has."""
    ours = {run.name for run in runs}
    for folder in (out / _RUNS).glob("*"):
        if folder.name not in ours:
            shutil.rmtree(folder)
    # in reverse order a folder comes after the files in it
    for path in sorted((path for name in _OWN_FOLDERS for path in (out / name).rglob("*")), reverse=True):
        if path.is_file() and path.relative_to(out).as_posix() not in kept:
            path.unlink()
        elif path.is_dir() and not any(path.iterdir()):
            path.rmdir()
