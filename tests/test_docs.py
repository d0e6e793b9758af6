"""The documentation: its commands work as written, it agrees with the code, and every page of it is on the site."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from markdown_it import MarkdownIt
from typer.testing import CliRunner

from magiclens.cli import app
from magiclens.config.model import LensSpec
from magiclens.contract.stages import KINDS
from magiclens.images import read_image, to_display
from magiclens.images.art import ART
from magiclens.images.files import write_png
from magiclens.images.likeness import likeness, word_for
from magiclens.images.score import psnr_db
from magiclens.plan.registry import STAGE, Registry
from magiclens.web.gallery.docs import Library, anchor_of, doc_page, doc_paths, inline_markup
from magiclens.web.gallery.drawings import DRAWINGS, PX_PER_MM, example_facet, seen_through
from magiclens.web.gallery.gallery_list import load_gallery
from magiclens.web.gallery.options import model_tables, value_kind
from magiclens.web.gallery.pictures import Album

ROOT = Path(__file__).parent.parent
PAGES = sorted((ROOT / "docs").rglob("*.md"))
DOORS = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", ".github/pull_request_template.md")]
"""Pages beside those of the site."""
ARCHITECTURE = ROOT / "docs" / "explanation" / "architecture.md"
RUN = "sh run"
"""What a code block is called that this test runs."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """The language and text of a page's code blocks."""
    tokens = MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8"))
    return [(token.info.strip(), token.content) for token in tokens if token.type == "fence"]


def commands(page: Path) -> list[str]:
    return [line for language, text in blocks(page) if language == RUN for line in text.splitlines()]


WITH_COMMANDS = [page for page in PAGES if commands(page)]


LONG = {"mill", "print", "first-lens", "encode-a-message"}
"""Pages whose commands take a minute and more."""
MARKED = [
    pytest.param(page, id=page.stem, marks=pytest.mark.sweep if page.stem in LONG else pytest.mark.tools)
    for page in WITH_COMMANDS
]


@pytest.mark.parametrize("page", MARKED)
def test_commands_work_as_they_are_written(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_png(tmp_path / "cat.png", ART["panda"](256))
    for language, text in blocks(page):
        named = re.match(r"# (\S+\.(yaml|py|toml))\n", text)
        if named and language in ("yaml", "python", "toml"):
            (tmp_path / named[1]).write_text(text, encoding="utf-8")
    if (tmp_path / "pyproject.toml").is_file():
        monkeypatch.syspath_prepend(installed(tmp_path))
    for line in commands(page):
        mlens, *words = shlex.split(line)
        assert mlens == "mlens"
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, f"{line}\n{done.output}"


def installed(package: Path) -> Path:
    """Where pip has put a page's package, once the package's own tests are green there."""
    site = package / "site"
    quiet = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "install", *quiet, "--target", str(site), str(package)]
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *map(str, package.glob("test_*.py"))]
    for command in (pip, tests):
        done = subprocess.run(command, cwd=package, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return site


def test_tutorial_and_how_tos_have_commands_that_are_run() -> None:
    assert {page.stem for page in WITH_COMMANDS} >= {
        "tutorial", "print", "coupon", "mill", "encode-a-message", "add-a-scenario",
    }  # fmt: skip


def test_every_page_is_in_the_gallerys_menu() -> None:
    gallery = load_gallery(ROOT / "gallery" / "gallery.yaml")
    listed = {page.resolve() for section in gallery.docs for page in section.pages}
    assert listed == set(PAGES)


@pytest.mark.parametrize("page", PAGES + DOORS, ids=[page.stem for page in PAGES + DOORS])
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    """To files of the repository, pictures too: pages are also read without the site."""
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r"\]\((?!https?:|mailto:)\w+:", text), "what only the site could show"
    for target, anchor in re.findall(r"\]\(([^)#\s:]*)(?:#([^)\s]+))?(?: \"[^\"]*\")?\)", text):
        found = page.parent / target if target else page
        assert found.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.+)$", found.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {anchor_of(heading.replace("`", "")) for heading in headings}, f"{target}#{anchor}"


def test_the_doors_lead_to_each_other() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "(CONTRIBUTING.md)" in readme
    assert "(docs/explanation/architecture.md)" in readme


@pytest.fixture
def drawer(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script that draws the architecture."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return import_module("draw_architecture")


def test_the_drawings_of_the_architecture_are_those_of_the_code(drawer: ModuleType) -> None:
    for path, drawn in drawer.drawings():
        assert path.read_text(encoding="utf-8") == drawn, "stale: run `python docs/draw_architecture.py`"


def test_the_drawings_of_the_optics_are_those_of_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs")
    drawn = dict(import_module("draw_optics").drawings())
    assert set(drawn) == set((ROOT / "docs" / "images" / "drawings").iterdir())
    for path, text in drawn.items():
        # the facet of free-form.svg is refined, which rounds in another way on other processors
        parts = r"<style>.*?</style>|<text.*?</text>" if path.stem == "free-form" else r".+"
        kept, now = (re.findall(parts, which, re.DOTALL) for which in (path.read_text(encoding="utf-8"), text))
        assert kept == now, "stale: run `python docs/draw_optics.py`"


def test_figures_of_runs_that_pages_show_are_those_of_lenses_in_the_gallery() -> None:
    entries = {entry.name for entry in load_gallery(ROOT / "gallery" / "gallery.yaml").entries}
    kept = ROOT / "docs" / "images" / "runs"
    shown = {found for page in PAGES for found in re.findall(r"images/runs/([\w/-]+\.png)", page.read_text("utf-8"))}
    assert shown == {path.relative_to(kept).as_posix() for path in kept.rglob("*.png")}
    assert {name.split("/")[0] for name in shown} <= entries


def test_the_drawing_of_the_layers_has_no_mark_against_them(drawer: ModuleType) -> None:
    imports, below = drawer.folder_imports(), set[str]()
    for layer in reversed(drawer.package_layers()):
        for name in layer:
            assert imports[name] <= below, name
        below |= set(layer)


def test_the_architecture_has_a_paragraph_on_every_folder() -> None:
    told = re.findall(r"^\*\*`(\w+)/`\*\*", ARCHITECTURE.read_text(encoding="utf-8"), re.MULTILINE)
    folders = {path.parent.name for path in (ROOT / "magiclens").glob("*/__init__.py")}
    assert len(told) == len(set(told))
    assert set(told) == folders


@pytest.fixture
def symptoms(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script that simulates what goes wrong."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return import_module("draw_symptoms")


def test_the_guide_from_symptom_to_cause_shows_every_simulated_picture(symptoms: ModuleType) -> None:
    text = (ROOT / "docs" / "how-to" / "when-it-does-not-work.md").read_text(encoding="utf-8")
    shown = re.findall(r"\.\./images/symptoms/([\w-]+)\.png", text)
    files = sorted(path.stem for path in (ROOT / "docs" / "images" / "symptoms").iterdir())
    assert sorted(shown) == files == sorted(symptoms.SYMPTOMS)


@pytest.mark.tools
def test_the_pictures_of_symptoms_are_those_of_the_code(symptoms: ModuleType) -> None:
    """As like as pictures are that are simulated on another processor."""
    for name, picture in symptoms.pictures():
        kept = read_image(symptoms.IMAGES / f"{name}.png")
        assert psnr_db(to_display(picture), to_display(kept)) > 20, f"{name}: run `python docs/draw_symptoms.py`"


@pytest.mark.parametrize("page", PAGES + DOORS, ids=[page.stem for page in PAGES + DOORS])
def test_what_pages_say_of_the_code_is_there(page: Path) -> None:
    """Files and folders that a page names, and functions of which it says in which file they are."""
    text = page.read_text(encoding="utf-8")
    made = {"magiclens/scenarios/stereo.py", "specs/stereo.yaml"}  # by the page's reader
    folders = r"magiclens|tests|specs|plugins|docs|gallery|benchmarks|\.github"
    for path in set(re.findall(rf"`((?:{folders})/[\w./-]*)`", text)) - made:
        assert (ROOT / path).exists(), path
    for name, path in re.findall(r"`(\w+(?:\.\w+)?)` in `(magiclens/[\w/]+\.py)`", text):
        last, code = name.split(".")[-1], (ROOT / path).read_text(encoding="utf-8")
        assert re.search(rf"^ *(def|class) {last}\b|^{last}\b", code, re.MULTILINE), name


def test_the_example_of_a_docstring_is_in_the_code() -> None:
    (example,) = (text for kind, text in blocks(ROOT / "CONTRIBUTING.md") if kind == "python")
    code = (path.read_text(encoding="utf-8") for path in (ROOT / "magiclens").rglob("*.py"))
    assert any(example.strip() in text for text in code)


def test_the_glossary_is_sorted_and_every_term_is_at_home_in_the_code() -> None:
    text = (ROOT / "docs" / "reference" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \*\*(.+?)\*\* \| .+? \| `(.+?)` \|$", text, re.MULTILINE)
    assert len(rows) == text.count("\n| **")
    terms = [term.replace(",", "").lower() for term, _ in rows]
    assert terms == sorted(set(terms))
    package = ROOT / "magiclens"
    code = "\n".join(path.read_text(encoding="utf-8") for path in package.rglob("*.py"))
    for term, home in rows:
        found = (package / home).exists() if "/" in home else re.search(rf"\b{re.escape(home)}\b", code)
        assert found, f"{term}: {home}"


def test_the_site_has_the_drawings_of_the_architecture(tmp_path: Path) -> None:
    pages = [ARCHITECTURE, *(ROOT / "docs" / "reference").glob("*.md")]
    page = doc_page(ARCHITECTURE, Library(tmp_path, Album(tmp_path), doc_paths(pages), {}))
    for path in re.findall(r'<img src="([^"]+\.svg)"', page.body):
        assert (tmp_path / page.path).parent.joinpath(path).resolve().is_file(), path
    assert page.body.count(".svg") == 2


@pytest.mark.parametrize("name", DRAWINGS)
def test_drawings_say_what_is_in_them_to_those_who_do_not_see_them(name: str) -> None:
    drawing = DRAWINGS[name]("a <drawing>")
    assert drawing.startswith("<svg ")
    assert 'role="img" aria-label="a &lt;drawing&gt;"' in drawing
    assert "nan" not in drawing


def test_the_drawn_facet_shows_its_corner_once_it_is_refined() -> None:
    """And its micro-facets look at ink or paper as they shall."""
    scene, shapes = example_facet()
    wanted = scene.views[0].target[..., 0] < 0.5
    (before, even), (after, bent) = (seen_through(scene, shape) for shape in shapes)
    column, row = np.moveaxis((np.stack([even, bent]) * (1, -1) + 10) * PX_PER_MM, -1, 0).astype(int)
    astray = (scene.views[0].source[row, column, 0] < 0.5) != wanted[1::3, 1::3]
    for was, left in (((before != wanted).mean(), (after != wanted).mean()), astray.mean(axis=(1, 2))):
        assert was > 0.05
        assert left < 0.02


def test_descriptions_are_escaped_but_for_code() -> None:
    assert inline_markup("`a<b` and <i>") == "<code>a&lt;b</code> and &lt;i&gt;"


def test_anchors_are_as_on_hosts_of_markdown() -> None:
    assert anchor_of("What a facet can do (4.2)") == "what-a-facet-can-do-42"


def test_options_are_told_in_words_with_units_and_limits() -> None:
    rows = {row[0]: row for row in model_tables(LensSpec)[0].rows}
    assert rows["`size`"] == ("`size`", "length", "`100mm`", "side of the square lens")
    assert rows["`facets`"][1] == "whole number, ≥ 1, ≤ 1024 or `auto`"
    assert rows["`cells`"][1] == "`eye` or `vertical`"
    assert value_kind({"type": "array", "items": {"type": "number"}}) == "list of number"


def test_every_option_of_every_stage_has_a_description() -> None:
    registry = Registry.load()
    for kind in KINDS:
        for name, cls in registry.classes(STAGE, kind).items():
            for table in model_tables(cls):
                for key, kinds, _, meaning in table.rows:
                    assert meaning or kinds.startswith("`"), f"{kind} {name}: {key}"
                    assert "anything" not in kinds, f"{kind} {name}: {key}"


@pytest.fixture
def verdicts(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script that draws the examples of verdicts."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return import_module("draw_verdicts")


def test_every_example_of_a_verdict_is_shown_under_its_word_and_gets_it(verdicts: ModuleType) -> None:
    text = (ROOT / "docs" / "explanation" / "verdicts.md").read_text(encoding="utf-8")
    sections = {part.split(":")[0].split("\n")[0].lower(): part for part in text.split("\n## ")[1:]}
    assert {path.stem for path in verdicts.IMAGES.iterdir()} == set(verdicts.EXAMPLES)
    for name, shown, wanted in verdicts.pictures():
        word = verdicts.EXAMPLES[name][2]
        assert f"/{name}.png" in sections[word], name
        assert word_for(likeness(shown, wanted)) == word, name
        kept = read_image(verdicts.IMAGES / f"{name}.png")
        assert word_for(likeness(kept, wanted)) == word, f"{name}: run `python docs/draw_verdicts.py`"


def test_the_limits_of_verdicts_are_those_of_the_page() -> None:
    text = (ROOT / "docs" / "explanation" / "verdicts.md").read_text(encoding="utf-8")
    limits = re.findall(r"^## ([\w ]+): .*?([\d.]+) or more", text, re.MULTILINE)
    assert [word.lower() for word, _ in limits] == ["clear", "recognisable", "hard to see"]
    for word, least in limits:
        assert word_for(float(least)) == word.lower() != word_for(float(least) - 0.001)
