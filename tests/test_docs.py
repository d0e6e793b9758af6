"""The documentation: its commands work as they are written, and every page of it is part of the site."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from markdown_it import MarkdownIt
from typer.testing import CliRunner

from magiclens.cli import app
from magiclens.config.model import LensSpec
from magiclens.contract.stages import KINDS
from magiclens.images.art import ART
from magiclens.images.files import write_png
from magiclens.plan.registry import STAGE, Registry
from magiclens.web.gallery.docs import inline, slug
from magiclens.web.gallery.drawings import DRAWINGS, PX_PER_MM, _one_facet, _seen_by
from magiclens.web.gallery.listed import load_gallery
from magiclens.web.gallery.options import model_tables, takes

ROOT = Path(__file__).parent.parent
PAGES = sorted((ROOT / "docs").rglob("*.md"))
RUN = "sh run"
"""What a code block is called that this test runs."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """The language and text of a page's code blocks."""
    tokens = MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8"))
    return [(token.info.strip(), token.content) for token in tokens if token.type == "fence"]


def commands(page: Path) -> list[str]:
    return [line for language, text in blocks(page) if language == RUN for line in text.splitlines()]


WITH_COMMANDS = [page for page in PAGES if commands(page)]


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=[page.stem for page in WITH_COMMANDS])
def test_commands_work_as_they_are_written(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(tmp_path / "cat.png", ART["panda"](256))
    for language, text in blocks(page):
        named = re.match(r"# (\S+\.yaml)\n", text)
        if language == "yaml" and named:
            (tmp_path / named[1]).write_text(text, encoding="utf-8")
        for line in text.splitlines() if language == RUN else ():
            mlens, *words = shlex.split(line)
            assert mlens == "mlens"
            done = CliRunner().invoke(app, words)
            assert done.exit_code == 0, f"{line}\n{done.output}"


def test_tutorial_and_how_tos_have_commands_that_are_run() -> None:
    assert {page.stem for page in WITH_COMMANDS} >= {"tutorial", "print", "mill", "encode-a-message"}


def test_every_page_is_in_the_gallerys_menu() -> None:
    gallery = load_gallery(ROOT / "gallery" / "gallery.yaml")
    listed = {page.resolve() for section in gallery.docs for page in section.pages}
    assert listed == set(PAGES)


@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+\.md)", text):
        assert (page.parent / target).is_file(), target
    entries = {entry.name for entry in load_gallery(ROOT / "gallery" / "gallery.yaml").entries}
    assert set(re.findall(r"\]\(drawing:([\w-]+)", text)) <= set(DRAWINGS)
    assert set(re.findall(r"\]\(run:([\w-]+)/", text)) <= entries


@pytest.mark.parametrize("name", DRAWINGS)
def test_drawings_say_what_is_in_them_to_those_who_do_not_see_them(name: str) -> None:
    drawing = DRAWINGS[name]("a <drawing>")
    assert drawing.startswith("<svg ")
    assert 'role="img" aria-label="a &lt;drawing&gt;"' in drawing
    assert "nan" not in drawing


def test_the_drawn_facet_shows_its_corner_once_it_is_refined() -> None:
    """And its micro-facets look at ink or paper as they shall."""
    scene, shapes = _one_facet()
    wanted = scene.views[0].target[..., 0] < 0.5
    (before, even), (after, bent) = (_seen_by(scene, shape) for shape in shapes)
    column, row = np.moveaxis((np.stack([even, bent]) * (1, -1) + 10) * PX_PER_MM, -1, 0).astype(int)
    astray = (scene.views[0].source[row, column, 0] < 0.5) != wanted[1::3, 1::3]
    for was, left in (((before != wanted).mean(), (after != wanted).mean()), astray.mean(axis=(1, 2))):
        assert was > 0.05
        assert left < 0.02


def test_descriptions_are_escaped_but_for_code() -> None:
    assert inline("`a<b` and <i>") == "<code>a&lt;b</code> and &lt;i&gt;"


def test_anchors_are_as_on_hosts_of_markdown() -> None:
    assert slug("What a facet can do (4.2)") == "what-a-facet-can-do-42"


def test_options_are_told_in_words_with_units_and_limits() -> None:
    rows = {row[0]: row for row in model_tables(LensSpec)[0].rows}
    assert rows["`size`"] == ("`size`", "length", "`100mm`", "side of the square lens")
    assert rows["`facets`"][1] == "whole number, ≥ 1, ≤ 1024"
    assert rows["`cells`"][1] == "`eye` or `vertical`"
    assert takes({"type": "array", "items": {"type": "number"}}) == "list of number"


def test_every_option_of_every_stage_has_a_description() -> None:
    registry = Registry.load()
    for kind in KINDS:
        for name, cls in registry.classes(STAGE, kind).items():
            for table in model_tables(cls):
                for key, kinds, _, meaning in table.rows:
                    assert meaning or kinds.startswith("`"), f"{kind} {name}: {key}"
                    assert "anything" not in kinds, f"{kind} {name}: {key}"
