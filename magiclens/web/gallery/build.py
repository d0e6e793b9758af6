"""Builds the site: runs first, then every page."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path

import magiclens
from magiclens.contract.errors import InputError
from magiclens.contract.executors import Executor
from magiclens.plan.registry import Registry
from magiclens.running.folder import atomic_file
from magiclens.running.jobs import Job
from magiclens.web.gallery.docs import FOLDER, DocPage, Library, doc_page, doc_paths, normal
from magiclens.web.gallery.lens import LensPage, lens_page
from magiclens.web.gallery.listed import Gallery, load_gallery
from magiclens.web.gallery.pages import Link, Site
from magiclens.web.gallery.parts import ReferencePage
from magiclens.web.gallery.pictures import Album
from magiclens.web.gallery.reference import Commands, reference
from magiclens.web.gallery.runs import Say, refresh
from magiclens.web.gallery.viewers import viewers

FACTS = "gallery.json"
"""By this file a gallery's folder is known."""
OURS = ("lenses", "pictures", FOLDER)
"""Folders of the site in which nothing stays that was not written for this list."""


def build_gallery(
    path: Path, out: Path, executor: Executor, registry: Registry, commands: Commands, quick: bool, say: Say
) -> None:
    """Write the site of a list into ``out``; runs that are there and still valid are not made again.

    quick: with the list's own smaller lenses. commands: the command line, for the reference. Equal lists and equal runs
    give equal pages. Raises InputError if the list, a spec or a page of documentation is wrong.
    """
    gallery = load_gallery(path)
    _claim(out)
    runs = {entry.name: out / "runs" / entry.name for entry in gallery.entries}
    jobs = [
        Job(str(entry.spec), entry.overrides(quick), str(runs[entry.name].absolute())) for entry in gallery.entries
    ]
    refresh(jobs, executor, registry, say)
    album, shown = Album(out), viewers(runs, out, executor)
    lenses = [lens_page(entry, runs[entry.name], shown[entry.name], album, quick) for entry in gallery.entries]
    library = Library(out, album, doc_paths([page for section in gallery.docs for page in section.pages]), runs)
    docs = {source: doc_page(source, library) for source in library.pages}
    texts = _texts(gallery, lenses, docs, reference(registry, commands, album))
    for name, text in {**texts, FACTS: _facts(lenses, quick)}.items():
        _write(out / name, text)
    _tidy(out, {*texts, *library.files, *album.paths}, runs.values())
    say(f"{out / 'index.html'}")


def _claim(out: Path) -> None:
    """Make the folder, or go on with the gallery in it. Raises InputError if it holds something else."""
    known = (out / FACTS).is_file() or not out.exists() or (out.is_dir() and not any(out.iterdir()))
    if not known:
        raise InputError(f"'{out}' is there already and is no gallery; choose another --out", "--out")
    out.mkdir(parents=True, exist_ok=True)
    if not (out / FACTS).is_file():
        _write(out / FACTS, "{}\n")


def _texts(
    gallery: Gallery, lenses: list[LensPage], docs: Mapping[Path, DocPage], generated: list[ReferencePage]
) -> dict[str, str]:
    """Every file of the site that is text, by its path; the front page comes last."""
    menu = {section.title: [_link(docs[normal(source)]) for source in section.pages] for section in gallery.docs}
    menu["Reference"] = [*menu.get("Reference", []), *map(_link, generated)]
    site = Site(gallery, menu, lenses)
    return {
        **{name: _asset(name) for name in ("look.css", "site.css", "site.js")},
        **{page.path: site.doc(page) for page in docs.values()},
        **{page.path: site.reference(page) for page in generated},
        **{f"lenses/{page.name}.html": site.lens(page) for page in lenses},
        f"{FOLDER}/index.html": site.contents(),
        "index.html": site.index(),
    }


def _link(page: DocPage | ReferencePage) -> Link:
    return Link(page.path, page.title)


def _asset(name: str) -> str:
    """A file of the site that is the same in every gallery."""
    package = "magiclens.pages" if name == "look.css" else "magiclens.web.gallery"
    return (files(package) / "templates" / name).read_text(encoding="utf-8")


def _facts(lenses: Iterable[LensPage], quick: bool) -> str:
    """The list for programs."""
    rows = [
        {"name": page.name, "title": page.entry.title, "label": page.entry.label, "views": page.facts["views"]}
        for page in lenses
    ]
    return json.dumps({"version": magiclens.__version__, "quick": quick, "lenses": rows}, indent=2) + "\n"


def _write(path: Path, text: str) -> None:
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _tidy(out: Path, kept: set[str], runs: Iterable[Path]) -> None:
    """Remove pages, pictures and runs of what the list no longer has."""
    ours = {run.name for run in runs}
    for folder in (out / "runs").iterdir():
        if folder.name not in ours:
            shutil.rmtree(folder)
    for path in sorted((path for name in OURS for path in (out / name).rglob("*")), reverse=True):
        if path.is_file() and path.relative_to(out).as_posix() not in kept:
            path.unlink()
        elif path.is_dir() and not any(path.iterdir()):
            path.rmdir()
